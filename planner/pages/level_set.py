"""The zero level set of a smooth distance field as triangles (surface nets, Gibson 1998).

One vertex per grid cell that the surface passes, at the mean of its crossings of the cell's edges;
one quadrilateral per edge that it crosses, between the four cells around. Newton steps along the
gradient then put the vertices onto the zero level. By hand, since no dependency of the toolkit
extracts level sets; a page needs no more than this.
"""

from __future__ import annotations

import numpy as np

from planner.shapes.field.distance_field import DistanceField
from planner.spatial import FloatArray, IntArray

__all__ = ["zero_level_set"]

MOST_CELLS = 72
"""Cells along the longest side: the grid is as fine as the field's own where that has no more."""

MARGIN = 2
"""Cells beyond the solid's bounding box."""

NEWTON_STEPS = 3
"""From within a cell to the level: to some micrometres where the field is smooth."""


def zero_level_set(
    field: DistanceField, lower: FloatArray, upper: FloatArray
) -> tuple[FloatArray, IntArray]:
    """Vertices (n, 3), m, and triangles (k, 3), counter-clockwise from outside.

    Args:
        field: Negative inside.
        lower: Lower corner (3,) of the box in which to look, m.
        upper: Its upper corner (3,).
    """
    spacing = max(field.spacing, float((upper - lower).max()) / MOST_CELLS)
    first = lower - MARGIN * spacing
    shape = np.ceil((upper - lower) / spacing).astype(int) + 2 * MARGIN + 1
    nodes = np.stack(np.meshgrid(*(np.arange(n) for n in shape), indexing="ij"), axis=-1)
    values = field.value(first + spacing * nodes.reshape(-1, 3)).reshape(shape)
    vertices, triangles = _nets(values)
    return _onto_level(field, first + spacing * vertices, spacing), triangles


def _nets(values: FloatArray) -> tuple[FloatArray, IntArray]:
    """Surface net of values at the nodes of a grid; vertices in units of the grid."""
    inside = values < 0.0
    cells = np.array(values.shape) - 1
    total, count = np.zeros((*cells, 3)), np.zeros(cells, dtype=int)
    crossings = []
    for axis in range(3):
        a, b = _ends(values, axis)
        crossed = (a < 0.0) != (b < 0.0)
        at = np.argwhere(crossed)
        share = (a[crossed] / (a[crossed] - b[crossed]))[:, None]
        points = at + share * np.eye(3)[axis]
        crossings.append((axis, at))
        for around in _around(axis):  # the four cells that share the edge
            cell = at - around
            there = ((cell >= 0) & (cell < cells)).all(axis=1)
            np.add.at(total, tuple(cell[there].T), points[there])
            np.add.at(count, tuple(cell[there].T), 1)
    passed = count > 0
    number = np.full(cells, -1)
    number[passed] = np.arange(passed.sum())
    vertices = total[passed] / count[passed][:, None]
    quads = []
    for axis, at in crossings:
        four = np.stack([at - around for around in _around(axis)], axis=1)  # (m, 4, 3)
        there = ((four >= 0) & (four < cells)).all(axis=(1, 2))
        corners = number[tuple(np.moveaxis(four[there], 2, 0))]
        outwards = inside[tuple(at[there].T)]
        corners[~outwards] = corners[~outwards][:, ::-1]
        quads.append(corners)
    q = np.concatenate(quads)
    triangles: IntArray = np.concatenate([q[:, [0, 1, 2]], q[:, [0, 2, 3]]]).astype(np.int64)
    return vertices, triangles


def _ends(values: FloatArray, axis: int) -> tuple[FloatArray, FloatArray]:
    """Values at both ends of every edge along an axis."""
    low = [slice(None)] * 3
    high = [slice(None)] * 3
    low[axis], high[axis] = slice(None, -1), slice(1, None)
    return values[tuple(low)], values[tuple(high)]


def _around(axis: int) -> IntArray:
    """Offsets (4, 3) of the cells around an edge, counter-clockwise seen from its end."""
    u, v = np.eye(3, dtype=np.int64)[(axis + 1) % 3], np.eye(3, dtype=np.int64)[(axis + 2) % 3]
    return np.array([u + v, v, 0 * u, u])


def _onto_level(field: DistanceField, points: FloatArray, spacing: float) -> FloatArray:
    """Points moved along the gradient to where the field is zero; never farther than a cell."""
    start = points
    for _ in range(NEWTON_STEPS):
        rows = field.taylor(points, 1)
        gradient = rows[:, 1:4]
        squared = np.maximum(np.einsum("nd,nd->n", gradient, gradient), 0.01)
        points = points - (rows[:, 0] / squared)[:, None] * gradient
    moved = np.linalg.norm(points - start, axis=1) <= spacing
    kept: FloatArray = np.where(moved[:, None], points, start)
    return kept
