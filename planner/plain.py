"""Results as plain data for JSON, which knows no NaN, no infinity and no arrays; short reprs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

__all__ = ["finite", "short_repr"]

SHORT = 200
"""Characters of a repr: two lines of a terminal."""


def short_repr(thing: object) -> str:
    """One line for ``__repr__`` of a report: its kind, and the first line of its text."""
    lines = str(thing).splitlines()
    text = f"<{type(thing).__name__}: {lines[0] if lines else ''}>"
    return text if len(text) <= SHORT else f"{text[: SHORT - 4]}...>"


def finite(value: Any) -> Any:
    """Plain data of a value: lists for arrays and tuples, None for a number that is not finite.

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
        return value if math.isfinite(value) else None
    return value
