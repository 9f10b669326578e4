"""Checks of numbers and arrays that a user gives, and results as plain data.

NumPy answers a wrong shape or a text with ValueError, TypeError or an unwanted broadcast. Here they
become one error of ours, once where they come in, which names what was given and what is allowed.
Plain data for JSON has no NaN, no infinity and no arrays.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from math import isfinite, isnan
from numbers import Integral
from typing import Any, TypeVar

import numpy as np

from planner.errors import ContactError, PlannerError, TaskError, shown
from planner.spatial import FloatArray

T = TypeVar("T")

__all__ = [
    "check_fields",
    "checked_count",
    "checked_kind",
    "checked_number",
    "finite",
    "finite_array",
    "finite_given",
    "float_array",
    "is_finite",
    "per_item",
    "short_names",
    "short_repr",
    "without_prefix",
]


def float_array(
    what: str,
    value: Any,
    *,
    error: type[PlannerError] = ContactError,
    copy: bool = False,
    wanted: str = "an array of numbers",
) -> FloatArray:
    """Numbers in any shape as an array of floats; copied if asked for.

    Raises:
        ContactError: Something else than numbers, or rows of different lengths; ``error`` if given.
    """
    if type(value) is np.ndarray and value.dtype == np.float64:
        return value.copy() if copy else value
    try:
        array = np.asarray(value)
        if array.dtype.kind not in "fiub":
            raise TypeError(f"an array of {array.dtype}")
        if isinstance(value, np.ma.MaskedArray) and value.mask.any():
            raise TypeError("some of it is masked")
        return np.array(array, dtype=np.float64) if copy else np.asarray(array, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as fault:
        raise error(f"{what} is {shown(value)} ({fault}); give {wanted}") from fault


def finite_array(
    what: str, value: Any, shape: tuple[int, ...], *, error: type[PlannerError] = ContactError
) -> FloatArray:
    """A copy, of floats, of an array of a shape, finite.

    Raises:
        ContactError: It is not; ``error`` if given.
    """
    array = float_array(what, value, error=error, copy=True)
    if array.shape != shape:
        raise error(f"{what} has shape {array.shape}; give {shape}")
    if not np.isfinite(array).all():
        raise error(f"{what} holds NaN or infinity; give finite numbers")
    return array


def finite_given(what: str, value: Any, shape: tuple[int, ...]) -> FloatArray:
    """As ``finite_array`` without a copy, for input at every step of a loop."""
    array = value if type(value) is np.ndarray else float_array(what, value)
    if array.dtype != np.float64:
        array = float_array(what, value)
    if array.shape != shape:
        raise ContactError(f"{what} has shape {array.shape}; give {shape}")
    if not is_finite(array):
        raise ContactError(f"{what} holds NaN or infinity; give finite numbers")
    return array


def is_finite(array: FloatArray) -> bool:
    """Whether all numbers are finite: by their sum of squares, one call instead of two."""
    return isfinite(np.vdot(array, array)) or bool(np.isfinite(array).all())


def per_item(what: str, value: Any, n: int) -> FloatArray:
    """A number or (n,) as (n,); infinity is allowed, NaN is not.

    Raises:
        ContactError: Another shape, or NaN.
    """
    if type(value) is float and value == value:
        return np.full(n, value)
    array = float_array(what, value)
    if array.shape not in ((), (n,)):
        raise ContactError(f"{what} has shape {array.shape}; give a number or ({n},)")
    if isnan(np.vdot(array, array)):
        raise ContactError(f"{what} holds NaN; give numbers")
    return array if array.shape else np.full(n, array)


def checked_number(
    what: str,
    value: Any,
    *,
    least: float = -np.inf,
    most: float = np.inf,
    above: float | None = None,
    infinite: bool = False,
    unit: str = "",
    error: type[PlannerError] = ContactError,
) -> float:
    """A number from ``least`` to ``most``, and larger than ``above`` if that is given.

    Args:
        what: Its name, for the message.
        value: What was given; True and False are no numbers.
        least: Smallest that is allowed.
        most: Largest that is allowed.
        above: What it has to exceed.
        infinite: Whether infinity is allowed where ``most`` is.
        unit: For the message.
        error: What is raised.

    Raises:
        ContactError: Something else; ``error`` if given.
    """
    if type(value) is float and least <= value <= most and isfinite(value) and above is None:
        return value
    array, said = _NAN, ""
    truth = isinstance(value, bool) or getattr(value, "dtype", None) == np.bool_
    if value is None or truth or isinstance(value, str | bytes | complex):
        said = ", not a number"
    else:
        array = float_array(what, value, error=error, wanted=f"a number{unit and f' in {unit}'}")
    within = array.shape == () and least <= array <= most and (infinite or np.isfinite(array))
    if not within or (above is not None and not array > above):
        low = "" if least == -np.inf else f" >= {least:g}"
        low = low if above is None else f" > {above:g}"
        high = "" if most == np.inf else f" {'and ' * bool(low)}<= {most:g}"
        if above is None and low and high:
            low, high = f" from {least:g}", f" to {most:g}"
        kind = "number" if infinite else "finite number"
        wanted = f"{kind}{low}{high}{unit and f' in {unit}'}"
        raise error(f"{what} is {shown(value)}{said}; give a {wanted}")
    return float(array)


def checked_count(
    what: str, value: Any, *, least: int, most: int, error: type[PlannerError] = ContactError
) -> int:
    """A whole number from ``least`` to ``most``.

    Raises:
        ContactError: Something else; ``error`` if given.
    """
    whole = isinstance(value, Integral) and not isinstance(value, bool)
    if not whole or not least <= int(value) <= most:
        raise error(f"{what} is {shown(value)}; give a whole number from {least} to {most}")
    return int(value)


def checked_kind(name: str, value: Any, kind: type[T]) -> T:
    """Something of a class.

    Raises:
        TaskError: It is of another.
    """
    if not isinstance(value, kind):
        raise TaskError(f"{name} is {shown(value)}; give a {kind.__name__}")
    return value


def check_fields(
    owner: Any,
    names: Iterable[str] = (),
    *,
    what: str = "",
    least: float = -np.inf,
    most: float = np.inf,
    above: float | None = None,
    infinite: bool = False,
    unit: str = "",
) -> None:
    """Check number fields of a dataclass by one range, each as what its annotation says.

    ``float`` is a number, ``int`` a whole one, ``tuple[float, float]`` so many in a row,
    ``tuple[float, ...]`` any number of them in a row, ``FloatArray`` in any shape; None where
    ``| None`` follows.

    Args:
        owner: The dataclass, in ``__post_init__``.
        names: Which fields; all of these kinds if none is named.
        what: What stands before the name of a field in messages.
        least: See ``checked_number``, as all that follow.
        most: Likewise.
        above: Likewise.
        infinite: Likewise.
        unit: Likewise.
    """
    kinds = {f.name: str(f.type) for f in fields(owner)}
    named = tuple(names) or [n for n, k in kinds.items() if k.startswith(_NUMBERS)]
    for name in named:
        value, kind, called = getattr(owner, name), kinds[name], f"{what}{name}"
        if value is None and kind.endswith("None"):
            continue
        if kind.startswith("int"):
            low = 0 if least == -np.inf else math.ceil(least)
            low = low if above is None else max(low, math.floor(above) + 1)
            high = MOST_COUNT if most == np.inf else int(most)
            checked_count(called, value, least=low, most=high, error=TaskError)
            continue
        if kind.startswith("float"):
            parts: Iterable[Any] = (value,)
        elif kind.startswith("tuple"):
            array = float_array(called, value, error=TaskError)
            length = "" if "..." in kind else f"{kind.count('float')} "
            if array.ndim != 1 or (length and len(array) != int(length)):
                raise TaskError(f"{called} is {shown(value)}; give {length}numbers in a row")
            parts = value
        else:
            parts = float_array(called, value, error=TaskError).ravel().tolist()
        for part in parts:
            checked_number(
                called, part, least=least, most=most, above=above, infinite=infinite, unit=unit,
                error=TaskError,
            )  # fmt: skip


_NUMBERS = ("float", "int", "tuple[float", "FloatArray")
"""How annotations of numbers begin."""

_NAN = np.array(np.nan)

MOST_COUNT = 2**63 - 1
"""Largest whole number: what NumPy and files hold."""


LARGEST_FLOAT = 1e12
"""Largest number of a file, either sign: products of several are finite."""

LARGEST_INT = 2**128
"""Largest whole number of a file, either sign: the seeds that NumPy draws fit."""

SHORT = 200
"""Characters of a repr: two lines of a terminal."""


def short_repr(thing: object) -> str:
    """One line for ``__repr__`` of a report: its kind, and the first line of its text."""
    lines = str(thing).splitlines()
    text = f"<{type(thing).__name__}: {lines[0] if lines else ''}>"
    return text if len(text) <= SHORT else f"{text[: SHORT - 4]}...>"


def finite(value: Any) -> Any:
    """Plain data of a value: lists for arrays and tuples, None for a number that is not finite.

    A number beyond ``LARGEST_FLOAT`` becomes that.

    Args:
        value: A number, an array, or mappings and sequences of these; anything else is kept.
    """
    if isinstance(value, Mapping):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    if isinstance(value, np.ndarray | np.generic):
        return finite(value.tolist())
    if isinstance(value, float):
        # a diverged simulation has larger ones, which no file may hold
        return max(-LARGEST_FLOAT, min(LARGEST_FLOAT, value)) if math.isfinite(value) else None
    return value


def without_prefix(names: Sequence[str]) -> tuple[str, tuple[str, ...]]:
    """What all names begin with, up to a separator, and the names without it.

    Args:
        names: Of joints, links or geoms: ``hand_right_index_0``, ``hand_right_thumb_0`` have the
            prefix ``hand_right_``. Fewer than two names keep all of theirs.
    """
    parts = [re.findall(r"[^_.:/ -]*[_.:/ -]+", name) for name in names] if len(names) > 1 else []
    end = 0
    for column in zip(*parts, strict=False):  # words with the separator behind them
        if len(set(column)) > 1:
            break
        end += len(column[0])
    if any(len(name) == end for name in names):  # one of them is the prefix itself
        end = 0
    return (names[0] if names else "")[:end], tuple(name[end:] for name in names)


def short_names(names: Sequence[str], width: int = 20) -> tuple[str, tuple[str, ...]]:
    """As ``without_prefix`` where a name is longer; then the middle of one is an ellipsis.

    Names that differ stay different: where ``width`` characters are too few, all get more.
    """
    prefix, rest = "", tuple(names)
    if max(map(len, rest), default=0) > width:
        prefix, rest = without_prefix(names)
    while True:
        tail = width // 2
        short = tuple(
            n if len(n) <= width else f"{n[: width - tail - 1]}…{n[len(n) - tail :]}" for n in rest
        )
        if len(set(short)) == len(set(rest)):
            return prefix, short
        width += 1
