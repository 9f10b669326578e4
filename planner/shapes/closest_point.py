"""Steps of closest-point queries that several shapes share."""

from __future__ import annotations

import numpy as np

from planner.spatial import FloatArray

ON_SURFACE = 1e-12
"""Points nearer than this (m) to the surface take the normal of the nearest face: the direction
from the surface point would be rounding noise."""

NO_LENGTH = 1e-15
"""Vectors shorter than this (m) have no direction: rounding of a point on a centre or an axis."""


def sign(values: FloatArray) -> FloatArray:
    """-1 where negative, else 1, of any shape."""
    return np.where(values < 0, -1.0, 1.0)


def unit(vectors: FloatArray) -> FloatArray:
    """Unit vectors (n, 3) of vectors (n, 3); +x where a vector has no length."""
    v = np.array(vectors, dtype=np.float64)
    length = np.linalg.norm(v, axis=1, keepdims=True)
    flat = length[:, 0] < NO_LENGTH
    v[flat], length[flat] = [1.0, 0.0, 0.0], 1.0
    out: FloatArray = v / length
    return out


def nearest_of_faces(
    points: FloatArray,
    clamped: FloatArray,
    depths: FloatArray,
    face_points: FloatArray,
    face_normals: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Nearest surface points of a convex solid with smooth faces and sharp edges.

    Args:
        points: (n, 3), m.
        clamped: The points of the solid nearest to ``points``, (n, 3), m.
        depths: How far each point is below each of k faces, (n, k), m.
        face_points: Each point moved onto each face, (n, k, 3), m.
        face_normals: Outward unit normals there, (n, k, 3).

    Returns:
        Surface points (n, 3) and outward normals (n, 3): from ``clamped`` for points outside, of
        the least deep face inside.
    """
    gap = points - clamped
    distance = np.linalg.norm(gap, axis=1)
    row, face = np.arange(len(points)), np.argmin(depths, axis=1)
    surface, normal = face_points[row, face], face_normals[row, face]
    outside = distance > ON_SURFACE
    surface[outside] = clamped[outside]
    normal[outside] = gap[outside] / distance[outside, None]
    return surface, normal


def nearest_on_cylinder(
    points: FloatArray, radius: float, half_height: float
) -> tuple[FloatArray, FloatArray]:
    """Nearest surface points (n, 3) and outward normals (n, 3) of a cylinder about z.

    Args:
        points: (n, 3), m, in the cylinder's frame.
        radius: m.
        half_height: Half of the full height, m.
    """
    radial = np.hypot(points[:, 0], points[:, 1])
    out = unit(np.column_stack([points[:, :2], np.zeros(len(points))]))
    axis = np.zeros_like(points)
    axis[:, 2] = sign(points[:, 2])
    clamped = out * np.minimum(radial, radius)[:, None]
    clamped[:, 2] = np.clip(points[:, 2], -half_height, half_height)
    side, end = out * radius, points.copy()
    side[:, 2] = points[:, 2]
    end[:, 2] = half_height * axis[:, 2]
    return nearest_of_faces(
        points,
        clamped,
        np.column_stack([radius - radial, half_height - np.abs(points[:, 2])]),
        np.stack([side, end], axis=1),
        np.stack([out, axis], axis=1),
    )
