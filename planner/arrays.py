"""Checks of numbers and arrays that a user gives, once where they come in.

NumPy answers a wrong shape or a text with ValueError, TypeError or an unwanted broadcast. Here they
become one error of ours, which names what was given and what is allowed.
"""

from __future__ import annotations

from math import isfinite, isnan
from numbers import Integral
from typing import Any

import numpy as np

from planner.errors import ContactError, PlannerError
from planner.spatial import FloatArray

__all__ = [
    "checked_count",
    "checked_number",
    "finite_array",
    "finite_given",
    "float_array",
    "is_finite",
    "per_item",
]


def float_array(
    what: str, value: Any, *, error: type[PlannerError] = ContactError, copy: bool = False
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
        return np.array(array, dtype=np.float64) if copy else np.asarray(array, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as fault:
        raise error(f"{what} is {_short(value)} ({fault}); give an array of numbers") from fault


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


def per_item(
    what: str, value: Any, n: int, *, error: type[PlannerError] = ContactError
) -> FloatArray:
    """A number or (n,) as (n,); infinity is allowed, NaN is not.

    Raises:
        ContactError: Another shape, or NaN; ``error`` if given.
    """
    if type(value) is float and value == value:
        return np.full(n, value)
    array = float_array(what, value, error=error)
    if array.shape not in ((), (n,)):
        raise error(f"{what} has shape {array.shape}; give a number or ({n},)")
    if isnan(np.vdot(array, array)):
        raise error(f"{what} holds NaN; give numbers")
    return array if array.shape else np.full(n, array)


def checked_number(
    what: str,
    value: Any,
    *,
    least: float = -np.inf,
    most: float = np.inf,
    above: float | None = None,
    unit: str = "",
    error: type[PlannerError] = ContactError,
) -> float:
    """A finite number from ``least`` to ``most``, and larger than ``above`` if that is given.

    Raises:
        ContactError: Something else; ``error`` if given.
    """
    if type(value) is float and least <= value <= most and isfinite(value) and above is None:
        return value
    array = float_array(what, value, error=error)
    within = array.shape == () and np.isfinite(array) and least <= array <= most
    if not within or (above is not None and not array > above):
        if above is not None:
            raise error(f"{what} is {_short(value)}; give a finite number > {above:g}")
        low = "" if least == -np.inf else f" from {least:g}"
        high = "" if most == np.inf else f" to {most:g}"
        raise error(
            f"{what} is {_short(value)}; give a finite number{low}{high}{unit and ' '}{unit}"
        )
    return float(array)


def checked_count(
    what: str, value: Any, *, least: int, most: int, error: type[PlannerError] = ContactError
) -> int:
    """A whole number from ``least`` to ``most``.

    Raises:
        ContactError: Something else; ``error`` if given.
    """
    if not isinstance(value, Integral) or not least <= int(value) <= most:
        raise error(f"{what} is {_short(value)}; give a whole number from {least} to {most}")
    return int(value)


SHORT = 60
"""Characters of a value that a message shows."""


def _short(value: Any) -> str:
    """A value as a message shows it."""
    text = " ".join(repr(value).split())
    return text if len(text) <= SHORT else f"{text[: SHORT - 3]}..."
