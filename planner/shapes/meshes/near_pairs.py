"""Pairs of boxes that overlap: a tree of boxes against itself, one level at a time in NumPy.

The boxes are sorted along a Morton curve; neighbours in that order form a complete binary tree, and
all pairs of one level are tested at once: 0.2 s of CPU for 200,000 triangles. coal finds the same
pairs, but hands each over as a Python object, and on a closed surface every triangle touches a
dozen others.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner.spatial import FloatArray, IntArray

Corners = tuple[NDArray[np.float32], NDArray[np.float32]]
"""Lower and upper corners (3, n) of the boxes of one level of the tree."""

GRID = 2**16 - 1
"""Cells along the longest extent by which boxes are sorted."""


def overlapping_boxes(low: FloatArray, high: FloatArray) -> tuple[IntArray, IntArray]:
    """Numbers (k,) and (k,) of all pairs of different boxes that overlap or touch, each pair once.

    Corners are rounded outwards to single precision, which may add pairs with a gap of 1e-7 of
    their coordinates.

    Args:
        low: Lower corners (n, 3).
        high: Upper corners (n, 3).
    """
    order = _morton_order(low + high)
    one = other = np.zeros(1, dtype=np.int64)
    for lower, upper in _levels(low[order], high[order])[1:]:
        unlike = one != other
        first = np.concatenate([2 * one, 2 * one, 2 * one + 1, 2 * one[unlike] + 1])
        second = np.concatenate([2 * other + 1, 2 * other, 2 * other + 1, 2 * other[unlike]])
        for d in range(3):
            hit = lower[d].take(first) <= upper[d].take(second)
            hit &= lower[d].take(second) <= upper[d].take(first)
            kept = np.flatnonzero(hit)
            first, second = first.take(kept), second.take(kept)
        one, other = first, second
    different = one != other
    return order[one[different]], order[other[different]]


def _levels(low: FloatArray, high: FloatArray) -> list[Corners]:
    """Boxes of each level, from the root down; the leaves are the given ones and empty ones."""
    n = len(low)
    leaves = 1 << max(0, n - 1).bit_length()
    lower = np.full((3, leaves), np.inf, dtype=np.float32)
    upper = np.full((3, leaves), -np.inf, dtype=np.float32)
    lower[:, :n] = np.nextafter(low.T.astype(np.float32), np.float32(-np.inf))
    upper[:, :n] = np.nextafter(high.T.astype(np.float32), np.float32(np.inf))
    levels = [(lower, upper)]
    while lower.shape[1] > 1:
        lower = np.minimum(lower[:, ::2], lower[:, 1::2])
        upper = np.maximum(upper[:, ::2], upper[:, 1::2])
        levels.append((lower, upper))
    return levels[::-1]


def _morton_order(points: FloatArray) -> IntArray:
    """Order (n,) of points (n, 3) along a Morton curve."""
    extent = float(np.ptp(points, axis=0).max())
    cells = ((points - points.min(axis=0)) * (GRID / max(extent, 1e-300))).astype(np.uint64)
    code = np.zeros(len(points), dtype=np.uint64)
    for d in range(3):
        code |= _spread(cells[:, d]) << np.uint64(d)
    return np.argsort(code)


def _spread(bits: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """The 16 bits of each number, two zeros between neighbours."""
    for shift, mask in (
        (32, 0x001F00000000FFFF),
        (16, 0x001F0000FF0000FF),
        (8, 0x100F00F00F00F00F),
        (4, 0x10C30C30C30C30C3),
        (2, 0x1249249249249249),
    ):
        bits = (bits | (bits << np.uint64(shift))) & np.uint64(mask)
    return bits
