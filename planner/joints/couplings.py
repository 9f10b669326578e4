"""``Coupling``: a linear tie between joints, C q = d, and sets of them without contradiction.

A kinematic coupling says which q exist; the transmission (``planner.joints.actuation``) says which
torques exist.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planner.errors import HandError, PlannerError
from planner.numerics.lp import NOT_KNOWN, solve_lp
from planner.numerics.qp import solve_qp
from planner.spatial import FloatArray

__all__ = [
    "Coupling",
    "check_couplings",
    "check_held",
    "coupled_extreme",
    "independent_couplings",
    "nearest_on_couplings",
]

RANK_TOL = 1e-8
"""A coupling repeats earlier ones if its unit row has less than this (-) outside their span."""

LOOSE_TOL = 1e-6
"""Share of a joint (-) that neither actuators nor couplings hold: rounding is below."""

VALUE_TOL = 1e-6
"""Largest difference (rad, for a unit row) between the values of a repeated coupling."""


@dataclass(frozen=True, kw_only=True)
class Coupling:
    """Kinematic coupling row @ q = value.

    Attributes:
        name: What it is called in the model or the description.
        row: (nq,), coefficients.
        value: rad (m), in the unit of row @ q.
        one_sided: Whether it is a stop that only pushes row @ q upwards, and is active in a grasp;
            an equality holds always and both ways.
    """

    name: str
    row: FloatArray
    value: float
    one_sided: bool


def independent_couplings(couplings: Sequence[Coupling], what: str) -> tuple[Coupling, ...]:
    """Couplings without those that repeat the ones before them: C then has full rank.

    Equalities come first, since a stop along an equality never acts.

    Args:
        couplings: Any couplings.
        what: Whose they are, for messages.

    Raises:
        HandError: Two of them contradict each other, or one has no coefficient.
    """
    kept: list[Coupling] = []
    basis: list[FloatArray] = []  # orthonormal rows
    values: list[float] = []  # basis @ q
    for coupling in sorted(couplings, key=lambda c: c.one_sided):
        size = float(np.linalg.norm(coupling.row))
        if size == 0.0:
            raise HandError(f"{what}: coupling {coupling.name!r} acts on no joint; leave it out")
        rest, value = coupling.row / size, coupling.value / size
        for row, known in zip(basis, values, strict=True):
            share = float(row @ rest)
            rest, value = rest - share * row, value - share * known
        left = float(np.linalg.norm(rest))
        if left > RANK_TOL:
            kept.append(coupling)
            basis.append(rest / left)
            values.append(value / left)
        elif (value if coupling.one_sided else abs(value)) > VALUE_TOL:
            raise HandError(
                f"{what}: coupling {coupling.name!r} contradicts the couplings before it, "
                f"{[c.name for c in kept]}, by {abs(value) * size:.4f}; correct or drop one of them"
            )
    return tuple(kept)


def check_couplings(
    couplings: Sequence[Coupling], lower: FloatArray, upper: FloatArray, what: str
) -> None:
    """See that some q within the joint ranges keeps every coupling.

    Args:
        couplings: The couplings.
        lower: Joint limits (nq,), finite.
        upper: Joint limits (nq,), finite.
        what: Whose they are, for messages.

    Raises:
        HandError: None does; the message names the coupling if one alone is impossible.
    """
    for c in couplings:
        reach = np.stack([c.row * lower, c.row * upper])
        low, high = float(reach.min(axis=0).sum()), float(reach.max(axis=0).sum())
        if not low - VALUE_TOL <= c.value <= high + VALUE_TOL:
            raise HandError(
                f"{what}: coupling {c.name!r} asks for {c.value:.4f}, and the joint ranges allow "
                f"[{low:.4f}, {high:.4f}]; correct the ranges, or write drop_couplings = "
                f"[{c.name!r}] under [repair] and describe the right coupling"
            )
    if couplings and coupled_extreme(np.zeros(len(lower)), couplings, lower, upper) is None:
        raise HandError(
            f"{what}: no q within the joint ranges keeps all couplings "
            f"{[c.name for c in couplings]} at once; correct them or the ranges"
        )


def coupled_extreme(
    cost: FloatArray, couplings: Sequence[Coupling], lower: FloatArray, upper: FloatArray
) -> FloatArray | None:
    """The joints (nq,) of least cost . q that keep every coupling and range; None if none do.

    Args:
        cost: (nq,).
        couplings: The couplings.
        lower: Joint limits (nq,), finite.
        upper: Joint limits (nq,), finite.

    Raises:
        PlannerError: A number is NaN, or no solver decides.
    """
    value = np.array([c.value for c in couplings])
    found = solve_lp(
        cost,
        np.array([c.row for c in couplings]).reshape(-1, len(cost)),
        np.column_stack([value, value]),
        np.column_stack([lower, upper]),
    )
    if found is NOT_KNOWN:
        raise PlannerError(
            f"no solver decides whether joints keep the couplings {[c.name for c in couplings]} "
            "within their ranges; write coefficients and ranges nearer to 1, or drop a coupling"
        )
    return None if found is None else found.x


def nearest_on_couplings(
    q: FloatArray, couplings: Sequence[Coupling], lower: FloatArray, upper: FloatArray
) -> FloatArray | None:
    """The joints nearest to q that keep every coupling and every range; None if none do.

    Distances are in shares of the joints' ranges.

    Args:
        q: Joints (nq,).
        couplings: Independent couplings.
        lower: Joint limits (nq,), finite.
        upper: Joint limits (nq,), finite.
    """
    span = np.maximum(upper - lower, LEAST_SPAN)
    matrix = np.array([c.row for c in couplings]).reshape(-1, len(q)) * span
    size = np.maximum(np.linalg.norm(matrix, axis=1), LEAST_SPAN)
    value = np.array([c.value for c in couplings]) / size
    matrix = matrix / size[:, None]
    found = solve_qp(np.eye(len(q)), -q / span, matrix, value, value, lower / span, upper / span)
    return None if found is None else np.clip(found * span, lower, upper)


LEAST_SPAN = 1e-9
"""Range (rad, m) of a joint that has none, to divide by."""


def check_held(
    joint_names: Sequence[str],
    moment: FloatArray,
    couplings: Sequence[Coupling],
    what: str,
    actuators: Sequence[str] = (),
) -> None:
    """See that actuators and couplings together hold every joint.

    Args:
        joint_names: nq names.
        moment: R (nu, nq) of the actuators.
        couplings: The couplings.
        what: Whose they are, for messages.
        actuators: nu names, for messages.

    Raises:
        HandError: Joints that can move while no actuator and no coupling notices.
    """
    rows = np.vstack([moment, *(c.row[None] for c in couplings)])
    size = np.linalg.norm(rows, axis=1, keepdims=True)
    rows = rows / np.where(size > 0, size, 1.0)
    loose = np.eye(len(joint_names)) - np.linalg.pinv(rows) @ rows  # projector on the rest
    free = [j for j, part in zip(joint_names, loose, strict=True) if abs(part).max() > LOOSE_TOL]
    together = {
        name: joints
        for name, row in zip(actuators, moment, strict=False)
        if len(joints := [j for j, arm in zip(joint_names, row, strict=True) if arm and j in free])
        > 1
    }
    if together:
        first, second, *_ = next(iter(together.values()))
        listed = ", ".join(f"{name!r} drives {joints}" for name, joints in together.items())
        raise HandError(
            f"{what}: actuators that drive several joints hold their sum alone ({listed}); what "
            "holds the rest is to be described. If a contact runs one of them to an end of its "
            f"range, add [[couplings]] with joints = {{ {first} = 1.0 }}, value = the lower end "
            'and kind = "stop" (for an upper end, both with a minus); if a gear ties them, joints '
            f'= {{ {first} = 1.0, {second} = -1.0 }} and kind = "equality". opposable hands '
            "--describe proposes the stops"
        )
    if free:
        raise HandError(
            f"{what}: no actuator and no coupling holds the joints {free}; add an [[actuators]] "
            "table with joints = [...], kp and force_limit for those that a motor drives, and a "
            "[[couplings]] table for those that follow others"
        )
