"""A mesh's distance field at one point, in loops (``planner.shapes.distance_field``)."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from planner.numerics.kernels import loops_of_kernels
from planner.shapes.distance_field import DistanceField
from planner.spatial import FloatArray, IntArray


class SplineTables(NamedTuple):
    """All levels of a field, the finest first, in flat arrays.

    Attributes:
        flat: Coefficients of all levels, m.
        first: Node at which cell 0 of each level begins (n, 3).
        inverse: 1 / spacing (n,), 1/m.
        last_cell: (n, 3).
        strides: Of each level along the axes (n, 3).
        start: Where each level begins in ``flat`` (n,).
        centre: Of the box of each level (n, 3), m.
        reach: Its half extents (n, 3), m.
        far_radius: m.
        weights: Of the coefficients by axis and derivative (36,), overwritten.
        found: Place for a result (10,), overwritten.
    """

    flat: FloatArray
    first: FloatArray
    inverse: FloatArray
    last_cell: IntArray
    strides: IntArray
    start: IntArray
    centre: FloatArray
    reach: FloatArray
    far_radius: float
    weights: FloatArray
    found: FloatArray


def spline_tables(field: DistanceField) -> SplineTables:
    """The levels of a field in flat arrays; for one run at a time."""
    t = field.tables
    return SplineTables(
        flat=t.flat,
        first=t.first,
        inverse=t.inverse[:, 0],
        last_cell=t.last_cell,
        strides=t.strides,
        start=t.start,
        centre=t.centre[:, 0],
        reach=t.reach[:, 0],
        far_radius=float(field.far_radius),
        weights=np.zeros(36),
        found=np.zeros(10),
    )


NO_FIELD = SplineTables(
    flat=np.zeros(0),
    first=np.zeros((0, 3)),
    inverse=np.zeros(0),
    last_cell=np.zeros((0, 3), dtype=np.int64),
    strides=np.zeros((0, 3), dtype=np.int64),
    start=np.zeros(0, dtype=np.int64),
    centre=np.zeros((0, 3)),
    reach=np.zeros((0, 3)),
    far_radius=0.0,
    weights=np.zeros(0),
    found=np.zeros(0),
)
"""The tables of a shape that is an expression."""


@loops_of_kernels
def taylor_at(
    tables: SplineTables, x: float, y: float, z: float, order: int, out: FloatArray, begin: int
) -> None:
    """Value and partial derivatives up to an order (1 or 2) at a point, m, into ``out`` (10).

    They begin at ``begin``.
    """
    level, n = 0, len(tables.inverse)
    while level < n and not (
        abs(x - tables.centre[level, 0]) <= tables.reach[level, 0]
        and abs(y - tables.centre[level, 1]) <= tables.reach[level, 1]
        and abs(z - tables.centre[level, 2]) <= tables.reach[level, 2]
    ):
        level += 1
    if level == n:
        far_taylor(x, y, z, tables.far_radius, out, begin)
        return
    w, inverse = tables.weights, tables.inverse[level]
    base = tables.start[level]
    for i in range(3):
        p = x if i == 0 else (y if i == 1 else z)
        u = p * inverse - tables.first[level, i]
        cell = min(int(max(u, 0.0)), tables.last_cell[level, i])
        base += cell * tables.strides[level, i]
        t = u - cell
        s = 1.0 - t
        o = 12 * i
        w[o] = s * s * s / 6.0
        w[o + 1] = (4.0 + t * t * (3.0 * t - 6.0)) / 6.0
        w[o + 2] = (1.0 + t * (3.0 + t * (3.0 - 3.0 * t))) / 6.0
        w[o + 3] = t * t * t / 6.0
        w[o + 4] = -0.5 * s * s
        w[o + 5] = t * (1.5 * t - 2.0)
        w[o + 6] = 0.5 + t * (1.0 - 1.5 * t)
        w[o + 7] = 0.5 * t * t
        w[o + 8] = s
        w[o + 9] = 3.0 * t - 2.0
        w[o + 10] = 1.0 - 3.0 * t
        w[o + 11] = t
    for i in range(10):
        out[begin + i] = 0.0
    for a in range(4):
        # along y of: value, slope and curvature along z; slopes along y
        v = vz = vzz = vy = vyz = vyy = 0.0
        for b in range(4):
            at = base + a * tables.strides[level, 0] + b * tables.strides[level, 1]
            f = fz = fzz = 0.0
            for c in range(4):
                coefficient = tables.flat[at + c]
                f += coefficient * w[24 + c]
                fz += coefficient * w[28 + c]
                fzz += coefficient * w[32 + c]
            v += w[12 + b] * f
            vy += w[16 + b] * f
            vz += w[12 + b] * fz
            vyy += w[20 + b] * f
            vyz += w[16 + b] * fz
            vzz += w[12 + b] * fzz
        out[begin] += w[a] * v
        out[begin + 1] += w[4 + a] * v
        out[begin + 2] += w[a] * vy
        out[begin + 3] += w[a] * vz
        if order == 2:
            out[begin + 4] += w[8 + a] * v
            out[begin + 5] += w[4 + a] * vy
            out[begin + 6] += w[4 + a] * vz
            out[begin + 7] += w[a] * vyy
            out[begin + 8] += w[a] * vyz
            out[begin + 9] += w[a] * vzz
    for i in range(1, 4):
        out[begin + i] *= inverse
    for i in range(4, 10):
        out[begin + i] *= inverse * inverse


@loops_of_kernels
def far_taylor(x: float, y: float, z: float, radius: float, out: FloatArray, begin: int) -> None:
    """The same of |p| - radius, away from the origin."""
    r = math.sqrt(x * x + y * y + z * z)
    out[begin] = r - radius
    out[begin + 1], out[begin + 2], out[begin + 3] = x / r, y / r, z / r
    k = begin + 4
    for i in range(1, 4):
        for j in range(i, 4):
            square = out[begin + i] * out[begin + j]
            out[k] = ((1.0 if i == j else 0.0) - square) / r
            k += 1
