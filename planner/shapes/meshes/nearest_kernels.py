"""Kernels of ``planner.shapes.meshes.nearest_triangle``: nearest triangles by a tree of balls."""

from __future__ import annotations

import math

import numpy as np

from planner.numerics.kernels import kernel, loops_of_kernels
from planner.shapes.meshes.triangles import FACE, nearest_on_triangles
from planner.spatial import FloatArray, IntArray

Found = tuple[FloatArray, IntArray, IntArray]
"""Nearest points (n, 3), m, numbers of their triangles (n,), and the features (n,) they are on."""

SAME = 1e-12
"""By how much (m) a ball may be farther than the nearest triangle so far and still be looked at:
of triangles that are equally near, the first is meant."""


def _nearest_plain(
    points: FloatArray,
    corners: FloatArray,
    numbers: IntArray,
    balls: FloatArray,
    nodes: FloatArray,
    leaves: IntArray,
) -> Found:
    """``nearest_triangles`` in NumPy: all triangles for each point."""
    surface, triangle = np.empty((len(points), 3)), np.empty(len(points), dtype=np.int64)
    feature = np.empty(len(points), dtype=np.int64)
    for i, point in enumerate(points):
        near, on = nearest_on_triangles(np.broadcast_to(point, (len(corners), 3)), corners)
        best = np.lexsort((numbers, ((near - point) ** 2).sum(axis=1)))[0]
        surface[i], triangle[i], feature[i] = near[best], numbers[best], on[best]
    return surface, triangle, feature


@kernel(_nearest_plain)
def nearest_triangles(
    points: FloatArray,
    corners: FloatArray,
    numbers: IntArray,
    balls: FloatArray,
    nodes: FloatArray,
    leaves: IntArray,
) -> Found:
    """The surface points nearest to points.

    Args:
        points: (n, 3), m.
        corners: Of the triangles (m, 3, 3), m; this and the rest as in ``BallTree``.
        numbers: Of the triangles (m,).
        balls: Around them (m, 4), m.
        nodes: Around those of each node, (nodes, 4), m.
        leaves: Where those of each leaf begin (leaves + 1,).

    Returns:
        Nearest points (n, 3), m, their triangles (n,), of several the first, and the features (n,)
        that they are on, see ``planner.shapes.meshes.triangles``.
    """
    n, inner = len(points), len(nodes) // 2
    surface, on = np.empty((n, 3)), np.empty(3)
    triangle, feature = np.empty(n, dtype=np.int64), np.empty(n, dtype=np.int64)
    stack, bounds = np.empty(64, dtype=np.int64), np.empty(64)
    for i in range(n):
        point = points[i]
        square, reach = np.inf, np.inf
        stack[0], bounds[0], top = 0, -np.inf, 1
        while top > 0:
            top -= 1
            node = stack[top]
            if bounds[top] > reach:
                continue
            if node < inner:
                near, far = 2 * node + 1, 2 * node + 2
                to_near, to_far = _to_ball(point, nodes[near]), _to_ball(point, nodes[far])
                if to_far < to_near:
                    near, far, to_near, to_far = far, near, to_far, to_near
                stack[top], bounds[top] = far, to_far
                stack[top + 1], bounds[top + 1] = near, to_near
                top += 2
                continue
            for f in range(leaves[node - inner], leaves[node - inner + 1]):
                if _to_ball(point, balls[f]) > reach:
                    continue
                which = _nearest_on_triangle(point, corners[f], on)
                x, y, z = on[0] - point[0], on[1] - point[1], on[2] - point[2]
                found = x * x + y * y + z * z
                if found < square or (found == square and numbers[f] < triangle[i]):
                    square, reach = found, math.sqrt(found) + SAME
                    triangle[i], feature[i] = numbers[f], which
                    surface[i, 0], surface[i, 1], surface[i, 2] = on[0], on[1], on[2]
    return surface, triangle, feature


def _within_plain(
    points: FloatArray,
    radius: float,
    corners: FloatArray,
    numbers: IntArray,
    balls: FloatArray,
    nodes: FloatArray,
    leaves: IntArray,
) -> tuple[IntArray, IntArray]:
    """``triangles_within`` in NumPy: all triangles for each point."""
    owners, found = [], []
    for i, point in enumerate(points):
        near, _ = nearest_on_triangles(np.broadcast_to(point, (len(corners), 3)), corners)
        mine = numbers[((near - point) ** 2).sum(axis=1) <= radius**2]
        owners.append(np.full(len(mine), i, dtype=np.int64))
        found.append(mine)
    none = np.zeros(0, dtype=np.int64)
    return np.concatenate([none, *owners]), np.concatenate([none, *found])


@kernel(_within_plain)
def triangles_within(
    points: FloatArray,
    radius: float,
    corners: FloatArray,
    numbers: IntArray,
    balls: FloatArray,
    nodes: FloatArray,
    leaves: IntArray,
) -> tuple[IntArray, IntArray]:
    """Triangles that come within a distance (m) of points, as pairs of both numbers, (k,) each.

    Sorted by point, of each as they are in the tree. Arguments as of ``nearest_triangles``.
    """
    inner, on = len(nodes) // 2, np.empty(3)
    stack = np.empty(64, dtype=np.int64)
    owners, found = np.empty(256, dtype=np.int64), np.empty(256, dtype=np.int64)
    k = 0
    for i in range(len(points)):
        point = points[i]
        stack[0], top = 0, 1
        while top > 0:
            top -= 1
            node = stack[top]
            if _to_ball(point, nodes[node]) > radius + SAME:
                continue
            if node < inner:
                stack[top], stack[top + 1] = 2 * node + 1, 2 * node + 2
                top += 2
                continue
            for f in range(leaves[node - inner], leaves[node - inner + 1]):
                _nearest_on_triangle(point, corners[f], on)
                x, y, z = on[0] - point[0], on[1] - point[1], on[2] - point[2]
                if x * x + y * y + z * z <= radius * radius:
                    if k == len(found):
                        owners, found = _twice_as_long(owners), _twice_as_long(found)
                    owners[k], found[k] = i, numbers[f]
                    k += 1
    return owners[:k], found[:k]


@loops_of_kernels
def _twice_as_long(values: IntArray) -> IntArray:
    """The same values, with as much space behind them."""
    out = np.empty(2 * len(values), dtype=np.int64)
    for i in range(len(values)):
        out[i] = values[i]
    return out


@loops_of_kernels
def _to_ball(point: FloatArray, ball: FloatArray) -> float:
    """Distance (m) of a point from a ball; negative inside."""
    x, y, z = point[0] - ball[0], point[1] - ball[1], point[2] - ball[2]
    return math.sqrt(x * x + y * y + z * z) - float(ball[3])


@loops_of_kernels
def _nearest_on_triangle(point: FloatArray, corners: FloatArray, on: FloatArray) -> int:
    """``nearest_on_triangles`` of one: its point (3,) is written, its feature returned."""
    best, feature = np.inf, 0
    for k in range(3):
        a, b = corners[k], corners[(k + 1) % 3]
        square = along = 0.0
        for d in range(3):
            square += (b[d] - a[d]) * (b[d] - a[d])
            along += (point[d] - a[d]) * (b[d] - a[d])
        share = min(max(along / square if square > 0.0 else along, 0.0), 1.0)
        gap = 0.0
        for d in range(3):
            apart = point[d] - (a[d] + share * (b[d] - a[d]))
            gap += apart * apart
        if gap < best:
            best = gap
            feature = k if share <= 0.0 else ((k + 1) % 3 if share >= 1.0 else k + 3)
            for d in range(3):
                on[d] = a[d] + share * (b[d] - a[d])
    a, b, c = corners[0], corners[1], corners[2]
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    wx, wy, wz = a[0] - c[0], a[1] - c[1], a[2] - c[2]
    vx, vy, vz = c[0] - b[0], c[1] - b[1], c[2] - b[2]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    area = nx * nx + ny * ny + nz * nz
    over = area > 0.0
    for k in range(3):
        ex, ey, ez = (ux, uy, uz) if k == 0 else ((vx, vy, vz) if k == 1 else (wx, wy, wz))
        px, py, pz = point[0] - corners[k, 0], point[1] - corners[k, 1], point[2] - corners[k, 2]
        inward = (ny * ez - nz * ey) * px + (nz * ex - nx * ez) * py + (nx * ey - ny * ex) * pz
        over = over and inward > 0.0
    if over:
        px, py, pz = point[0] - a[0], point[1] - a[1], point[2] - a[2]
        height = (px * nx + py * ny + pz * nz) / area
        on[0], on[1], on[2] = point[0] - height * nx, point[1] - height * ny, point[2] - height * nz
        return FACE
    return feature
