"""How far the normal at the nearest surface point can turn while a point outside moves.

A point is rho off a convex surface and moves by at most e < rho. Whatever the shape, the normal at
its nearest point turns by at most asin(e / rho) (``planner.certify.pose``). Of shapes that are
known more can be said:

round   A body in which a ball of radius R rolls freely is a smaller convex body blown up by R
        (Blaschke), with the same normals. So rho may be replaced by rho + R. R is the radius of a
        sphere or capsule, and the least radius of curvature of an ellipsoid, c^2 / a for its
        shortest and longest half axes. A flat face has no turn at all.
edge    Where the contact is h from the edge of its face, the point must overhang the edge before
        the normal turns over it. Seen along the edge, the point begins at the distance
        D = sqrt(h^2 + rho^2) from it, atan(h / rho) short of overhanging, and e takes it
        asin(e / D) further: the normal turns by at most asin(e / D) - atan(h / rho), if that is
        positive. A corner adds nothing, since |o| + h <= |o + (h, h)| for overhangs o >= 0. The rim
        of a cylinder is such an edge for its caps and for its side, whose round turn is added.
"""

from __future__ import annotations

import numpy as np

from planner.shapes import Box, Capsule, Cylinder, Ellipsoid, Shape, Sphere
from planner.spatial import FloatArray

__all__ = ["largest_turn"]

ALIGNED = 1e-9
"""Components of a normal below this (-) are none."""


def largest_turn(
    shape: Shape, points: FloatArray, normals: FloatArray, radii: FloatArray, moved: FloatArray
) -> FloatArray:
    """Bound of the turn of the normal at nearest points, (n,), rad.

    Args:
        shape: A convex shape.
        points: Nearest surface points (n, 3) at first, m, shape's frame.
        normals: Outward normals (n, 3) there; the moving points are at ``points`` + radius normal.
        radii: Distances rho (n,) from the surface at first, m.
        moved: Largest way e (n,) of each point, m; nothing (pi / 2) is known from the radius on.
    """
    curvature, gap = _known(shape, points, normals)
    any_shape = _arcsin(moved / radii)
    over = _arcsin(moved / np.hypot(gap, radii)) - np.arctan2(gap, radii)
    this_shape = _arcsin(moved / (radii + curvature)) + np.maximum(over, 0.0)
    return np.where(moved < radii, np.minimum(any_shape, this_shape), np.pi / 2)


def _known(shape: Shape, points: FloatArray, normals: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Radius of curvature (n,) and distance to the nearest edge (n,), m, each may be infinite.

    0 and infinite where nothing is known, such as at an edge.
    """
    n = len(points)
    curvature, gap = np.zeros(n), np.full(n, np.inf)
    if isinstance(shape, Sphere | Capsule):
        curvature += shape.sizes[0]
    elif isinstance(shape, Ellipsoid):
        curvature += shape.half_extents.min() ** 2 / shape.half_extents.max()
    elif isinstance(shape, Box):
        face = np.abs(normals) > 1.0 - ALIGNED
        gaps = np.where(face, np.inf, shape.half_extents - np.abs(points)).min(axis=1)
        flat = face.any(axis=1)
        curvature[flat], gap[flat] = np.inf, gaps[flat]
    elif isinstance(shape, Cylinder):
        radius, height = shape.sizes
        cap = np.abs(normals[:, 2]) > 1.0 - ALIGNED
        side = np.abs(normals[:, 2]) < ALIGNED
        curvature[cap], curvature[side] = np.inf, radius
        gap[cap] = radius - np.linalg.norm(points[cap, :2], axis=1)
        gap[side] = 0.5 * height - np.abs(points[side, 2])
    return curvature, np.maximum(gap, 0.0)


def _arcsin(sine: FloatArray) -> FloatArray:
    """The angle, rad; pi / 2 beyond a sine of 1."""
    return np.asarray(np.arcsin(np.minimum(sine, 1.0)))
