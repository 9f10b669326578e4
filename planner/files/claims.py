"""Check of the figures in a plan file against its grasp.

Readers of the JSON without this package rely on its quality, gaps and clearances. They are computed
again from the joints, and a file with other figures is refused. Figures that are not unique are
checked by their defining property: an interval encloses the true value as tightly as ours, the
weights of closure balance, and no wrench is harder to balance than the weakest. Texts are not
compared.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from planner.contacts import ContactSet
from planner.errors import FileFormatError, shown
from planner.quality import primitive_wrenches

QUALITY_REL_TOL = 1e-3
"""How far stored figures may be from those computed again, as a share of the larger (-): contacts
recomputed on another machine differ by rounding, 1e-9 and less."""

QUALITY_ABS_TOL = 1e-6
"""The same in their own unit, for figures near zero."""

CLEARANCE_TOL = 1e-4
"""The same for gaps and clearances, m: as for the positions of contacts."""

LARGEST_FIGURE = 1e300
"""Largest figure of a grasp, in any unit."""

INTERVALS = ("epsilon_round", "epsilon_linf")
WORDS = ("reason",)
CERTIFICATES = ("weights", "weakest_wrench_n_nm")


def check_quality(
    claimed: Mapping[str, Any], true: Mapping[str, Any], contacts: ContactSet, source: str
) -> None:
    """Refuse a claimed quality that the contacts do not have.

    Args:
        claimed: What the file says, as ``QualityReport.to_dict`` writes it.
        true: The same from the contacts.
        contacts: The contacts of the plan, world axes.
        source: What errors call the file.

    Raises:
        FileFormatError: A figure is missing, unknown, or another one.
    """
    for name, value in _pairs(claimed, true, "quality", source):
        known = true[name]
        if name == "closure":
            if not isinstance(value, Mapping):
                raise _other(source, f"quality.{name}")
            for part, claim in _pairs(value, known, "quality.closure", source):
                if part not in (*WORDS, *CERTIFICATES) and not _agree(claim, known[part]):
                    raise _other(source, f"quality.closure.{part}", claim, known[part])
        elif name in INTERVALS:
            if not _encloses(value, known):
                raise _other(source, f"quality.{name}", value, known)
        elif name not in CERTIFICATES and not _agree(value, known):
            raise _other(source, f"quality.{name}", value, known)
    length = true["length_m"]
    wrenches = primitive_wrenches(contacts, true["edges"], length=length)
    if not _balance(claimed["closure"]["weights"], true["closure"], wrenches):
        raise _other(source, "quality.closure.weights")
    weakest = _numbers(claimed["weakest_wrench_n_nm"], 6)
    if weakest is not None:
        unit = weakest / np.repeat([1.0, length], 3)
        reach = float((-unit @ wrenches).max(initial=0.0))
        is_unit = _agree(float(np.linalg.norm(unit)), 1.0)
        if is_unit and reach <= true["epsilon"] * (1 + QUALITY_REL_TOL) + QUALITY_ABS_TOL:
            return
    raise _other(source, "quality.weakest_wrench_n_nm")


def check_clearances(
    claimed: Mapping[str, float], true: Mapping[str, float], what: str, source: str
) -> None:
    """Refuse claimed distances (m), by what they are between, that are not those of the joints.

    Two pairs that are equally far apart may stand for each other at the end of the list.

    Raises:
        FileFormatError: There are others.
    """
    last = max(true.values(), default=0.0)
    if len(claimed) != len(true):
        raise _other(source, what)
    for pair, distance in claimed.items():
        if abs(distance - true.get(pair, last)) > CLEARANCE_TOL:
            raise _other(source, f"{what}, {pair!r}", distance, true.get(pair))


def _pairs(claimed: Mapping[str, Any], true: Mapping[str, Any], what: str, source: str) -> Any:
    if set(claimed) != set(true):
        raise _other(source, f"list of figures in {what}", sorted(claimed), sorted(true))
    return claimed.items()


def _other(source: str, what: str, claimed: Any = None, true: Any = None) -> FileFormatError:
    compared = ""
    if claimed is not None or true is not None:
        compared = f" ({shown(claimed, 140)}, recomputed {shown(true, 140)})"
    return FileFormatError(
        f"{source}: its {what} is not that of its joints{compared}; it is damaged, or was "
        "changed: plan again, or write the plan again where it was made"
    )


def _numbers(value: Any, n: int) -> Any:
    """So many finite numbers as an array, else None."""
    good = isinstance(value, list) and len(value) == n
    if not good or not all(_is_figure(x) for x in value):
        return None
    return np.array(value, dtype=np.float64)


def _is_figure(value: Any) -> bool:
    """Whether it is a finite number; a whole one may have more digits than a float can hold."""
    is_number = isinstance(value, float | int) and not isinstance(value, bool)
    return is_number and abs(value) <= LARGEST_FIGURE


def _agree(claimed: Any, true: Any) -> bool:
    """Whether two figures are the same but for rounding; None and lists only if they are equal."""
    if isinstance(true, bool) or not isinstance(true, float | int):
        return type(claimed) is type(true) and bool(claimed == true)
    if not _is_figure(claimed):
        return False
    return bool(np.isclose(claimed, true, rtol=QUALITY_REL_TOL, atol=QUALITY_ABS_TOL))


def _encloses(claimed: Any, true: Any) -> bool:
    """Whether an interval meets the true one and its ends are no farther than that one is wide."""
    ends = _numbers(claimed, 2)
    if ends is None or ends[0] > ends[1]:
        return False
    slack = true[1] - true[0] + QUALITY_REL_TOL * abs(true[1]) + QUALITY_ABS_TOL
    return bool(
        np.abs(ends - true).max() <= slack
        and ends[0] <= true[1] + QUALITY_ABS_TOL
        and true[0] <= ends[1] + QUALITY_ABS_TOL
    )


def _balance(claimed: Any, closure: Mapping[str, Any], wrenches: Any) -> bool:
    """Whether weights prove closure: of sum 1, none below the min-weight, without resultant."""
    if closure["weights"] is None:
        return claimed is None
    weights = _numbers(claimed, wrenches.shape[1])
    if weights is None or not _agree(float(weights.sum()), 1.0):
        return False
    least = closure["min_weight"] * (1 - QUALITY_REL_TOL) - QUALITY_ABS_TOL
    return bool(weights.min() >= least and np.abs(wrenches @ weights).max() <= BALANCE_TOL)


BALANCE_TOL = 1e-6
"""Largest resultant of the weights of closure per newton of normal force (-)."""
