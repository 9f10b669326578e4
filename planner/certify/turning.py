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

from planner.shapes import Shape
from planner.spatial import FloatArray

__all__ = ["largest_turn"]


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
    curvature, gap = shape.curvature_and_edges(points, normals)
    gap = np.maximum(gap, 0.0)
    any_shape = _arcsin(moved / radii)
    over = _arcsin(moved / np.hypot(gap, radii)) - np.arctan2(gap, radii)
    this_shape = _arcsin(moved / (radii + curvature)) + np.maximum(over, 0.0)
    return np.where(moved < radii, np.minimum(any_shape, this_shape), np.pi / 2)


def _arcsin(sine: FloatArray) -> FloatArray:
    """The angle, rad; pi / 2 beyond a sine of 1."""
    return np.asarray(np.arcsin(np.minimum(sine, 1.0)))
