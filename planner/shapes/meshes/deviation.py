"""How far a mended surface is from the one that was given."""

from __future__ import annotations

import coal
import numpy as np

from planner.shapes.meshes.nearest_triangle import NearestTriangles, coal_tree
from planner.shapes.meshes.triangles import cover
from planner.spatial import FloatArray, IntArray

Surface = tuple[FloatArray, IntArray]
"""Vertices (n, 3), m, and faces (m, 3)."""

MOST_POINTS = 3_000
"""Points, about, on the triangles of either surface that the other has not."""

SAME = 1e-12
"""Distance (m) below which the middles of two triangles are one: rounding."""


def deviation(given: Surface, mended: Surface) -> float:
    """Largest distance (m) between two surfaces where they differ, to a micrometre.

    Of points of the mended surface from the given one, and of points of the given one outside the
    mended solid from its surface. What lies inside is matter, and could never be touched.

    Args:
        given: Vertices (n, 3), m, and faces (m, 3).
        mended: The same of a sound surface.
    """
    fresh, gone = _only_in(mended, given), _only_in(given, mended)
    moved = 0.0
    if len(fresh):
        moved = float(_distances(given, _points(mended[0][mended[1][fresh]])).max())
    if len(gone):
        points = _points(given[0][given[1][gone]])
        surface, _, normal = NearestTriangles(*mended).nearest(points)
        gap = points - surface
        outside = np.einsum("nd,nd->n", gap, normal) > 0
        moved = max(moved, float(np.linalg.norm(gap[outside], axis=1).max(initial=0.0)))
    return moved


def _only_in(one: Surface, other: Surface) -> IntArray:
    """Faces (k,) of the first surface that the second has not, however they are wound."""
    mine, theirs = (np.round(v[f].mean(axis=1) / SAME).astype(np.int64) for v, f in (one, other))
    known = set(map(tuple, theirs.tolist()))
    return np.flatnonzero([tuple(middle) not in known for middle in mine.tolist()])


def _points(corners: FloatArray) -> FloatArray:
    """Points spread over triangles (k, 3, 3), and some of their corners."""
    edges = np.roll(corners, -1, axis=1) - corners
    area = float(np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1).sum()) / 2
    length = float(np.linalg.norm(edges, axis=2).max(axis=1).sum())  # needles have no area
    spread, _ = cover(corners, max(float(np.sqrt(area / MOST_POINTS)), length / MOST_POINTS, SAME))
    own = np.unique(corners.reshape(-1, 3), axis=0)
    return np.concatenate([p[:: max(1, len(p) // MOST_POINTS)] for p in (spread, own)])


def _distances(surface: Surface, points: FloatArray) -> FloatArray:
    """Distances (n,), m, of points (n, 3) from triangles that need not bound anything."""
    tree, probe = coal_tree(*surface), coal.Sphere(0.0)  # coal keeps no reference of its own
    measure = coal.ComputeDistance(tree, probe)
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    identity, pose = coal.Transform3s.Identity(), coal.Transform3s.Identity()
    out = np.empty(len(points))
    for i, point in enumerate(points):
        pose.setTranslation(point)
        result.clear()
        out[i] = measure(identity, pose, request, result)
    return np.maximum(out, 0.0)
