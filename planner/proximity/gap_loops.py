"""Loops: the distance of a convex body from a triangle, by Gilbert, Johnson and Keerthi (GJK).

A body is a core and a radius around it. The core is a box, which may be flat, a segment or a point
(so spheres and capsules are such bodies too), a cylinder, an ellipsoid or the hull of points, all
about the origin of the body's frame. GJK finds the point of the core less the triangle that is
nearest to the origin: a point v of it is the nearest one if no other is farther towards the origin,
and the support point w along v bounds the distance from below by v . w / |v|.

Distances of boxes and hulls are exact to rounding, those of curved cores to ``GAP``.
"""

from __future__ import annotations

import math

import numpy as np

from planner.numerics.kernels import loops_of_kernels
from planner.spatial import FloatArray

__all__ = ["BOX", "CYLINDER", "ELLIPSOID", "POINTS", "gap_to_triangle"]

BOX, CYLINDER, ELLIPSOID, POINTS = range(4)
"""Cores, by half extents along x, y, z; symmetry axes along z; or points."""

GAP = 1e-11
"""Distance (m) between bounds from above and below at which a distance is known."""

MEETING = 1e-10
"""Distance (m) up to which core and triangle count as meeting."""

STEPS = 100
"""Most steps; thin ellipsoids take 30."""


@loops_of_kernels
def gap_to_triangle(
    kind: int,
    core: FloatArray,
    points: FloatArray,
    begin: int,
    end: int,
    corners: FloatArray,
    limit: float,
    work: FloatArray,
) -> float:
    """Distance (m) of a core from a triangle, or the limit where it is not below; 0 if they meet.

    Args:
        kind: Of the core.
        core: Half extents (3,) of the core, or of the box around its points, m.
        points: Points of all bodies (k, 3), m.
        begin: The first of this one.
        end: Behind its last.
        corners: Of the triangle (3 corners, 3), m, in the body's frame.
        limit: m.
        work: (14, 4), overwritten. Where the distance is below the limit, rows 8 and 9 begin with
            the nearest points of core and triangle, m, in the body's frame.
    """
    # rows 0 to 3: the simplex; 4 to 7: the points of the core that it comes from
    v, w, three, share = work[10], work[11], work[12], work[13]
    for k in range(3):
        middle = (corners[0, k] + corners[1, k] + corners[2, k]) / 3.0
        v[k] = min(max(middle, -core[k]), core[k]) - middle
    size = math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    if size == 0.0:
        v[2] = size = 1.0
    n, square = 0, np.inf
    for _ in range(STEPS):
        _support(kind, core, points, begin, end, v, w)
        far, most = 0, -np.inf
        for c in range(3):
            ahead = corners[c, 0] * v[0] + corners[c, 1] * v[1] + corners[c, 2] * v[2]
            if ahead > most:
                far, most = c, ahead
        for k in range(3):
            work[4 + n, k] = w[k]
            work[n, k] = w[k] - corners[far, k]
        below = work[n, 0] * v[0] + work[n, 1] * v[1] + work[n, 2] * v[2]
        if below >= limit * size:
            return limit
        if n > 0 and size * size - below <= GAP * size:
            return size
        for i in range(n):
            same = True
            for k in range(3):
                same = same and work[i, k] == work[n, k]
            if same:
                return size
        n = _nearest_of_simplex(work, n + 1, share, three)
        if n == 0:
            return 0.0
        x = y = z = 0.0
        for i in range(n):
            x += share[i] * work[i, 0]
            y += share[i] * work[i, 1]
            z += share[i] * work[i, 2]
        found = x * x + y * y + z * z
        if found >= square:  # rounding: no nearer
            return size
        square, size = found, math.sqrt(found)
        v[0], v[1], v[2] = x, y, z
        for k in range(3):
            on_core = 0.0
            for i in range(n):
                on_core += share[i] * work[4 + i, k]
            work[8, k], work[9, k] = on_core, on_core - v[k]
        if size <= MEETING:
            return 0.0
    return size


@loops_of_kernels
def _support(
    kind: int,
    core: FloatArray,
    points: FloatArray,
    begin: int,
    end: int,
    v: FloatArray,
    out: FloatArray,
) -> None:
    """The point (3,) of a core that is farthest against a direction v (3,)."""
    if kind == BOX:
        for k in range(3):
            out[k] = -core[k] if v[k] > 0.0 else core[k]
    elif kind == CYLINDER:
        across = math.sqrt(v[0] * v[0] + v[1] * v[1])
        out[0], out[1] = core[0], 0.0
        if across > 0.0:
            out[0], out[1] = -core[0] * v[0] / across, -core[1] * v[1] / across
        out[2] = -core[2] if v[2] > 0.0 else core[2]
    elif kind == ELLIPSOID:
        x, y, z = core[0] * v[0], core[1] * v[1], core[2] * v[2]
        length = math.sqrt(x * x + y * y + z * z)
        out[0], out[1], out[2] = -core[0] * x / length, -core[1] * y / length, -core[2] * z / length
    else:
        far, least = begin, np.inf
        for i in range(begin, end):
            ahead = points[i, 0] * v[0] + points[i, 1] * v[1] + points[i, 2] * v[2]
            if ahead < least:
                far, least = i, ahead
        for k in range(3):
            out[k] = points[far, k]


@loops_of_kernels
def _nearest_of_simplex(work: FloatArray, n: int, share: FloatArray, three: FloatArray) -> int:
    """Leave those of n points whose mix is nearest to the origin; 0 if it is among four of them.

    Args:
        work: The points, rows 0 to 3, and rows 4 to 7 that go with them.
        n: How many there are.
        share: Their shares in that mix (4,), written.
        three: (3,), overwritten.

    Returns:
        How many are left.
    """
    if n == 1:
        share[0] = 1.0
        return 1
    if n == 2:
        along = square = 0.0
        for k in range(3):
            edge = work[1, k] - work[0, k]
            along -= work[0, k] * edge
            square += edge * edge
        part = min(max(along / square, 0.0), 1.0) if square > 0.0 else 0.0
        share[0], share[1] = 1.0 - part, part
    elif n == 3:
        _nearest_of_three(work[0], work[1], work[2], three)
        for i in range(3):
            share[i] = three[i]
    else:
        inside, least = True, np.inf
        for apex in range(4):
            a, b, c = (apex + 1) % 4, (apex + 2) % 4, (apex + 3) % 4
            if _parted(work[a], work[b], work[c], work[apex]):
                inside = False
                _nearest_of_three(work[a], work[b], work[c], three)
                square = 0.0
                for k in range(3):
                    x = three[0] * work[a, k] + three[1] * work[b, k] + three[2] * work[c, k]
                    square += x * x
                if square < least:
                    least, share[apex] = square, 0.0
                    share[a], share[b], share[c] = three[0], three[1], three[2]
        if inside:
            return 0
    left = 0
    for i in range(n):
        if share[i] > 0.0:
            share[left] = share[i]
            for k in range(3):
                work[left, k], work[4 + left, k] = work[i, k], work[4 + i, k]
            left += 1
    return left


@loops_of_kernels
def _parted(a: FloatArray, b: FloatArray, c: FloatArray, apex: FloatArray) -> bool:
    """Whether the plane through a, b and c does not have the origin on the apex's side."""
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    wx, wy, wz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    nx, ny, nz = uy * wz - uz * wy, uz * wx - ux * wz, ux * wy - uy * wx
    of_apex = nx * (apex[0] - a[0]) + ny * (apex[1] - a[1]) + nz * (apex[2] - a[2])
    of_origin = -(nx * a[0] + ny * a[1] + nz * a[2])
    return bool(of_apex * of_origin <= 0.0)


@loops_of_kernels
def _nearest_of_three(a: FloatArray, b: FloatArray, c: FloatArray, share: FloatArray) -> None:
    """Shares (3,) of three points in that point of their triangle that is nearest to the origin."""
    along_b = along_c = to_b = to_c = b_at_c = c_at_b = 0.0
    for k in range(3):
        e, f = b[k] - a[k], c[k] - a[k]
        along_b -= e * a[k]
        along_c -= f * a[k]
        to_b -= e * b[k]
        c_at_b -= f * b[k]
        b_at_c -= e * c[k]
        to_c -= f * c[k]
    share[0] = share[1] = share[2] = 0.0
    if along_b <= 0.0 and along_c <= 0.0:
        share[0] = 1.0
        return
    if to_b >= 0.0 and c_at_b <= to_b:
        share[1] = 1.0
        return
    if to_c >= 0.0 and b_at_c <= to_c:
        share[2] = 1.0
        return
    of_c = along_b * c_at_b - to_b * along_c
    if of_c <= 0.0 and along_b >= 0.0 and to_b <= 0.0:
        share[1] = along_b / (along_b - to_b)
        share[0] = 1.0 - share[1]
        return
    of_b = b_at_c * along_c - along_b * to_c
    if of_b <= 0.0 and along_c >= 0.0 and to_c <= 0.0:
        share[2] = along_c / (along_c - to_c)
        share[0] = 1.0 - share[2]
        return
    of_a = to_b * to_c - b_at_c * c_at_b
    past, back = c_at_b - to_b, b_at_c - to_c
    if of_a <= 0.0 and past >= 0.0 and back >= 0.0:
        share[2] = past / (past + back)
        share[1] = 1.0 - share[2]
        return
    whole = of_a + of_b + of_c
    share[1], share[2] = of_b / whole, of_c / whole
    share[0] = 1.0 - share[1] - share[2]
