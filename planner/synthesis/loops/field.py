"""A mesh's distance field at one point, in loops (``planner.shapes.field.distance_field``)."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from planner.numerics.kernels import loops_of_kernels
from planner.shapes.field.distance_field import DistanceField
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


@lru_cache(maxsize=8)
def spline_tables(field: DistanceField) -> SplineTables:
    """The levels of a field in flat arrays."""
    levels = field.levels
    shapes = np.array([level.coefficients.shape for level in levels])
    lower = np.array([level.lower for level in levels])
    upper = np.array([level.upper for level in levels])
    strides = [shapes[:, 1] * shapes[:, 2], shapes[:, 2], np.ones(len(levels), dtype=np.int64)]
    return SplineTables(
        flat=field.flat,
        # cell k of a level lies between its nodes k + 1 and k + 2
        first=np.array([level.first + 1 for level in levels], dtype=np.float64),
        inverse=np.array([1.0 / level.spacing for level in levels]),
        last_cell=shapes - 4,
        strides=np.ascontiguousarray(np.stack(strides, axis=1)),
        start=np.concatenate([[0], np.cumsum(shapes.prod(axis=1))[:-1]]),
        centre=(lower + upper) / 2,
        reach=(upper - lower) / 2,
        far_radius=float(field.far_radius),
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
)
"""The tables of a shape that is an expression."""


@loops_of_kernels
def taylor_at(tables: SplineTables, p: FloatArray, order: int, out: FloatArray) -> None:
    """Value and partial derivatives up to an order (1 or 2) at a point (3,), into ``out`` (10,)."""
    n = len(tables.inverse)
    level = n
    for k in range(n):
        inside = True
        for i in range(3):
            inside &= abs(p[i] - tables.centre[k, i]) <= tables.reach[k, i]
        if inside:
            level = k
            break
    if level == n:
        far_taylor(p, tables.far_radius, out)
        return
    w = np.empty((3, 3, 4))  # axis, derivative, coefficient
    inverse = tables.inverse[level]
    base = tables.start[level]
    for i in range(3):
        u = p[i] * inverse - tables.first[level, i]
        cell = min(int(max(u, 0.0)), tables.last_cell[level, i])
        base += cell * tables.strides[level, i]
        t = u - cell
        s = 1.0 - t
        w[i, 0, 0] = s * s * s / 6.0
        w[i, 0, 1] = (4.0 + t * t * (3.0 * t - 6.0)) / 6.0
        w[i, 0, 2] = (1.0 + t * (3.0 + t * (3.0 - 3.0 * t))) / 6.0
        w[i, 0, 3] = t * t * t / 6.0
        w[i, 1, 0] = -0.5 * s * s
        w[i, 1, 1] = t * (1.5 * t - 2.0)
        w[i, 1, 2] = 0.5 + t * (1.0 - 1.5 * t)
        w[i, 1, 3] = 0.5 * t * t
        w[i, 2, 0] = s
        w[i, 2, 1] = 3.0 * t - 2.0
        w[i, 2, 2] = 1.0 - 3.0 * t
        w[i, 2, 3] = t
    for i in range(10):
        out[i] = 0.0
    stride_x, stride_y = tables.strides[level, 0], tables.strides[level, 1]
    for a in range(4):
        # along y of: value, slope and curvature along z; slopes along y
        v = vz = vzz = vy = vyz = vyy = 0.0
        for b in range(4):
            at = base + a * stride_x + b * stride_y
            c0, c1 = tables.flat[at], tables.flat[at + 1]
            c2, c3 = tables.flat[at + 2], tables.flat[at + 3]
            f = c0 * w[2, 0, 0] + c1 * w[2, 0, 1] + c2 * w[2, 0, 2] + c3 * w[2, 0, 3]
            fz = c0 * w[2, 1, 0] + c1 * w[2, 1, 1] + c2 * w[2, 1, 2] + c3 * w[2, 1, 3]
            v += w[1, 0, b] * f
            vy += w[1, 1, b] * f
            vz += w[1, 0, b] * fz
            if order == 2:
                fzz = c0 * w[2, 2, 0] + c1 * w[2, 2, 1] + c2 * w[2, 2, 2] + c3 * w[2, 2, 3]
                vyy += w[1, 2, b] * f
                vyz += w[1, 1, b] * fz
                vzz += w[1, 0, b] * fzz
        out[0] += w[0, 0, a] * v
        out[1] += w[0, 1, a] * v
        out[2] += w[0, 0, a] * vy
        out[3] += w[0, 0, a] * vz
        if order == 2:
            out[4] += w[0, 2, a] * v
            out[5] += w[0, 1, a] * vy
            out[6] += w[0, 1, a] * vz
            out[7] += w[0, 0, a] * vyy
            out[8] += w[0, 0, a] * vyz
            out[9] += w[0, 0, a] * vzz
    for i in range(1, 4):
        out[i] *= inverse
    for i in range(4, 10):
        out[i] *= inverse * inverse


@loops_of_kernels
def far_taylor(p: FloatArray, radius: float, out: FloatArray) -> None:
    """The same of |p| - radius, away from the origin."""
    r = math.sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2])
    out[0] = r - radius
    k = 4
    for i in range(3):
        out[1 + i] = p[i] / r
        for j in range(i, 3):
            out[k] = ((1.0 if i == j else 0.0) - p[i] / r * (p[j] / r)) / r
            k += 1
