"""Convex hulls as coal geometries, for any number of neighbours per corner.

coal refuses a hull with a corner of 255 or more neighbours ("Too many neighbors"). Such corners
have two causes. A flat face of many corners is triangulated as a fan from one of them: joggled
input (Qhull's QJ, by 1e-13 m) leaves no face flat and gives another triangulation. The apex of a
cone has as many neighbours as its rim has corners: it is cut off by a micrometre, and the new
corners share the neighbours.
"""

from __future__ import annotations

from typing import Any

import coal
import numpy as np

from planner.errors import ModelError
from planner.spatial import FloatArray, IntArray

BLUNT = 1e-6
"""How far (m) from an apex its edges are cut: nothing of the hull that is lost is farther than that
from what remains. It is coal's accuracy."""

MOST_NEIGHBOURS = 200
"""Neighbours up to which a corner stays as it is; coal refuses 255."""

SHARE = 64
"""Neighbours, about, of each corner that takes the place of an apex."""


def convex_geometry(corners: FloatArray) -> Any:
    """The convex hull with these corners as a ``coal.Convex``.

    Args:
        corners: (n, 3), m, of a solid: not in one plane, or coal crashes.
    """
    hull = _coal_hull(corners, "Qt")  # triangulated, as coal asks for
    if hull is None:
        hull = _coal_hull(corners, "QJ")
    if hull is None:
        hull = _coal_hull(_blunted(corners), "QJ")
    if hull is None:  # never: no corner has more than some SHARE neighbours by now
        raise ModelError(f"coal refuses a convex hull of {len(corners)} corners; simplify the mesh")
    return hull


TOO_MANY = "Too many neighbors"
"""coal's message about a corner with too many neighbours."""


def _coal_hull(corners: FloatArray, options: str) -> Any | None:
    """The hull by coal; None where a corner has too many neighbours."""
    points = coal.StdVec_Vec3s()
    points.extend(list(np.asarray(corners, dtype=np.float64)))
    try:
        return coal.Convex.convexHull(points, True, options)
    except RuntimeError as fault:
        if TOO_MANY not in str(fault):
            raise
    return None


def _blunted(corners: FloatArray) -> FloatArray:
    """Corners (m, 3) of a hull (n, 3), m, with the apices cut off that have too many neighbours."""
    edges = _edges(corners)
    crowded = np.flatnonzero(np.bincount(edges[:, 0], minlength=len(corners)) > MOST_NEIGHBOURS)
    parts = [np.delete(corners, crowded, axis=0)]
    for apex in crowded:
        along = corners[edges[edges[:, 0] == apex, 1]] - corners[apex]
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        around = along[_turns(along)]
        parts.append(corners[apex] + BLUNT * around[::SHARE])
    return np.concatenate(parts)


def _edges(corners: FloatArray) -> IntArray:
    """Both ways of every edge of a hull with these corners, (k, 2) numbers of corners."""
    from scipy.spatial import ConvexHull  # here, since SciPy loads slowly

    simplices = ConvexHull(corners, qhull_options="QJ").simplices
    ways = [simplices[:, [a, b]] for a in range(3) for b in range(3) if a != b]
    return np.unique(np.concatenate(ways), axis=0).astype(np.int64)


def _turns(along: FloatArray) -> IntArray:
    """The order of directions (n, 3) around their mean."""
    axis = along.mean(axis=0)
    first = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    second = np.cross(axis, first) / max(float(np.linalg.norm(axis)), TINY)
    order: IntArray = np.argsort(np.arctan2(along @ second, along @ first))
    return order


TINY = 1e-300
"""Against division by 0."""
