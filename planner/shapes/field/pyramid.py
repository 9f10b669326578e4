"""Signed distances at the nodes of nested grids, measured near the surface only.

Each grid has twice the spacing of the next finer one. The coarsest is measured as a whole; on every
finer one the nodes within ``NEAR`` of its spacings of the surface are measured, and the others are
interpolated from the coarser one, where the distance is smooth. So the work grows with the area of
the surface, and the number of nodes hardly matters.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner.spatial import FloatArray, IntArray

NEAR = (2, 3, 5, 5)
"""Nodes that are measured on the finest grid, the next one, and so on: those of which a point of
the surface is within so many spacings along each axis, and a few more. The last holds for all
coarser ones."""

BEGIN = 8
"""Spacing of the grid that is measured as a whole, in spacings of the first that is asked for."""

Measure = Callable[[FloatArray, bool], FloatArray]
"""Signed distance (n,), m, of points (n, 3), m, and whether they are near the surface."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Grid:
    """Values at the nodes of a grid; node k is at k times the spacing.

    Attributes:
        first: Index (3,) of the first node.
        spacing: m.
        values: (nx, ny, nz).
    """

    first: IntArray
    spacing: float
    values: FloatArray


class Pyramid:
    """Samples of a distance, from coarse grids to fine ones.

    Attributes:
        last: The grid that was asked for last; empty before.
        measured: (nx, ny, nz), which of its nodes were measured.
    """

    def __init__(self, measure: Measure, points: FloatArray, finest: float) -> None:
        """Begin without a grid.

        Args:
            measure: The distance.
            points: Points (k, 3) all over the surface, m, about a spacing of the finest grid apart
                or less.
            finest: Spacing of the finest grid that will be asked for, m.
        """
        self._measure, self._points, self._finest = measure, points, finest
        self.last = Grid(first=np.zeros(3, dtype=np.int64), spacing=0.0, values=np.zeros((0, 0, 0)))
        self.measured: NDArray[np.bool_] = np.zeros((0, 0, 0), dtype=bool)

    def sample(self, first: IntArray, shape: tuple[int, int, int], spacing: float) -> FloatArray:
        """Signed distance (nx, ny, nz), m, of the nodes of a grid.

        The spacing must be that of the grid before over a power of two, and the grid be within it
        but for a few nodes.

        Args:
            first: Index (3,) of the first node.
            shape: Counts of the nodes.
            spacing: m.
        """
        if not self.last.values.size:
            h = spacing * BEGIN
            begin = first // BEGIN
            x, y, z = ((first + np.array(shape) - 1) // BEGIN + 2 - begin).tolist()
            whole = self._measure(grid_nodes(begin, (x, y, z), h), False)
            self.last = Grid(first=begin, spacing=h, values=whole.reshape(x, y, z))
        # what each grid on the way must hold for the next finer one to be interpolated
        wanted = [(first, np.array(shape))]
        for _ in range(round(np.log2(self.last.spacing / spacing)) - 1):
            lower, count = wanted[-1]
            upper = (lower + count - 1) // 2 + 3
            wanted.append((lower // 2 - 1, upper - lower // 2 + 1))
        for k, (lower, count) in reversed(list(enumerate(wanted))):
            self.last = self._finer(self.last, lower, count, spacing * 2**k)
        return self.last.values

    def _finer(self, coarse: Grid, first: IntArray, shape: IntArray, spacing: float) -> Grid:
        """The next grid: interpolated, and measured near the surface."""
        values = _interpolated(coarse, first, shape)
        cells = np.floor(self._points / spacing).astype(np.int64) - first
        halvings = min(round(np.log2(spacing / self._finest)), len(NEAR) - 1)
        self.measured = within_cells(cells, values.shape, NEAR[halvings])
        nodes: FloatArray = (np.argwhere(self.measured) + first) * np.float64(spacing)
        values[self.measured] = self._measure(nodes, halvings < 2)
        return Grid(first=first, spacing=spacing, values=values)


def grid_nodes(first: IntArray, shape: tuple[int, ...], h: float) -> FloatArray:
    """Nodes (nx ny nz, 3) of a grid, m: first node (3,), counts (3,), spacing (m)."""
    axes = [(f + np.arange(s)) * h for f, s in zip(first, shape, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def within_cells(cells: IntArray, shape: tuple[int, ...], reach: int) -> NDArray[np.bool_]:
    """Nodes (nx, ny, nz) of which one of some cells is at most a number of nodes away, each axis.

    Cell k lies between nodes k and k + 1; both of them are one node away.

    Args:
        cells: (n, 3), counted from the first node; anywhere.
        shape: Counts of the nodes.
        reach: How many nodes, at least 1.
    """
    wide = tuple(s + 2 * reach for s in shape)
    inside = ((cells >= 1 - reach) & (cells < np.array(shape) + reach - 1)).all(axis=1)
    x, y, z = (cells[inside] + reach).T
    marks = np.zeros(wide, dtype=bool)
    marks.reshape(-1)[(x * wide[1] + y) * wide[2] + z] = True
    for axis in range(3):
        a = np.moveaxis(marks, axis, 0)
        n = len(a) - 2 * reach
        # node k takes what is in cells k - reach .. k + reach - 1
        parts = a[:n].copy()
        for shift in range(1, 2 * reach):
            parts |= a[shift : shift + n]
        marks = np.moveaxis(parts, 0, axis)
    return marks


def _interpolated(coarse: Grid, first: IntArray, shape: IntArray) -> FloatArray:
    """Values on a part of the grid of half the spacing, cubic along each axis.

    Where the coarse grid ends, it is continued by its last node.
    """
    lower = first // 2 - 1
    upper = (first + shape - 1) // 2 + 3  # beyond the last
    out = coarse.values
    for axis in range(3):
        have = np.arange(lower[axis], upper[axis]) - coarse.first[axis]
        a = np.moveaxis(out, axis, 0)[np.clip(have, 0, out.shape[axis] - 1)]
        fine = np.empty((2 * (len(a) - 3), *a.shape[1:]))
        fine[::2] = a[1:-2]
        fine[1::2] = (9 * (a[1:-2] + a[2:-1]) - (a[:-3] + a[3:])) / 16
        begin = first[axis] - 2 * (lower[axis] + 1)
        out = np.moveaxis(fine[begin : begin + shape[axis]], 0, axis)
    return np.ascontiguousarray(out)
