"""Results as plain data for JSON (no NaN, no infinity, no arrays), and as short texts."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

__all__ = ["finite", "short_repr", "without_prefix"]

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
