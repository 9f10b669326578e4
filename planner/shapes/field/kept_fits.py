"""Whether what was kept on disk for a mesh is of that mesh: pieces and fields are checked at load.

Both are costly to make and cheap to check at points: 2 to 20 ms for meshes of 12 to 2,000
triangles, against 0.3 to 10 s to make them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planner.shapes.base import Shape
from planner.shapes.decomposition.hulls import hull_of
from planner.shapes.field.distance_field import DistanceField
from planner.shapes.meshes.polyhedron import moments
from planner.spatial import FloatArray, IntArray

__all__ = ["field_fits", "pieces_fit"]

EXACT = 1e-6
"""Distance (m), or share of a volume (-), by which what is computed again may differ."""

CHECKED = 256
"""Vertices of a mesh, about, at which a field is checked, and points in its bounding box."""


def field_fits(mesh: Shape, corners: FloatArray, field: DistanceField) -> bool:
    """Whether a field is within its own error of a mesh's distance, at points in its box.

    Args:
        mesh: The mesh.
        corners: Its vertices (n, 3), m.
        field: What was kept for it.
    """
    numbers = [field.far_radius, field.error, *(level.spacing for level in field.levels)]
    if not np.isfinite(numbers).all() or min(numbers) <= 0 or field.error > mesh.bounding_radius:
        return False
    if not all(np.isfinite(level.coefficients).all() for level in field.levels):
        return False
    lower, upper = corners.min(axis=0), corners.max(axis=0)
    inside = np.random.default_rng(0).uniform(lower, upper, (CHECKED, 3))
    points = np.concatenate([corners[:: max(1, len(corners) // CHECKED)], inside])
    off = np.abs(field.value(points) - mesh.signed_distance(points))
    return bool(off.max() <= field.error + EXACT)


def pieces_fit(
    mesh: Shape,
    corners: FloatArray,
    pieces: Sequence[tuple[FloatArray, IntArray]],
    deviation: float,
) -> bool:
    """Whether pieces are convex, cover a mesh, and reach out of it no farther than they say.

    Args:
        mesh: The mesh.
        corners: Its vertices (n, 3), m.
        pieces: Vertices (k, 3), m, and faces (m, 3) of each.
        deviation: How far (m) they are said to reach out of it.
    """
    if len(pieces) == 0 or not 0 <= deviation <= mesh.bounding_radius:
        return False
    covered = np.full(len(corners), np.inf)
    volume = 0.0
    for vertices, faces in pieces:
        if not _is_polyhedron(vertices, faces):
            return False
        hull = hull_of(vertices)
        if hull is None or abs(moments(vertices[faces])[0] / hull.volume - 1) > EXACT:
            return False
        if mesh.signed_distance(vertices).max() > deviation + EXACT:
            return False
        covered = np.minimum(covered, -hull.depths(corners))
        volume += hull.volume
    return bool(covered.max() <= EXACT and volume >= mesh.volume * (1 - EXACT))


def _is_polyhedron(vertices: FloatArray, faces: IntArray) -> bool:
    """Whether arrays are of the form of a polyhedron, with finite numbers."""
    if vertices.ndim != 2 or vertices.shape[1] != 3 or not np.isfinite(vertices).all():
        return False
    if faces.ndim != 2 or faces.shape[1] != 3 or len(faces) < 4:
        return False
    return bool(faces.min() >= 0 and faces.max() < len(vertices))
