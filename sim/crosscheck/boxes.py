"""The space that a coal geometry takes, as a bounding box: a common measure of shape, size, place.

A box, exact in given axes, tells a wrong size, scale, pose or kind of shape without any pairing of
coal's types with MuJoCo's: a mesh read as triangles and its convex hull have the same box.
"""

from __future__ import annotations

from typing import Any

import coal
import numpy as np

from planner.spatial import SE3, FloatArray


def bounding_box(geometry: Any, pose: SE3) -> FloatArray | None:
    """Lowest and highest corner (2, 3), m, of a geometry in the frame where its pose is given.

    Args:
        geometry: coal geometry.
        pose: Its pose.

    Returns:
        The corners; None for what has no end (planes) and for kinds that no model file has.
    """
    points = _vertices(geometry)
    if points is not None:
        placed = points @ pose.rotation.T + pose.translation
        return np.stack([placed.min(axis=0), placed.max(axis=0)])
    half = _half_extents(geometry, pose.rotation)
    return None if half is None else np.stack([pose.translation - half, pose.translation + half])


def _vertices(geometry: Any) -> FloatArray | None:
    if isinstance(geometry, coal.Convex):
        return np.array([geometry.point(i) for i in range(geometry.num_points)])
    if isinstance(geometry, coal.BVHModelBase):
        return np.array([geometry.vertex(i) for i in range(geometry.num_vertices)])
    return None


def _half_extents(geometry: Any, rotation: FloatArray) -> FloatArray | None:
    """Half of the box's edges (3,): the support of the shape along each axis."""
    axis = np.abs(rotation[:, 2])  # of a capsule or cylinder
    if isinstance(geometry, coal.Sphere):
        return np.full(3, geometry.radius)
    if isinstance(geometry, coal.Capsule):
        return np.asarray(axis * geometry.halfLength + geometry.radius)
    if isinstance(geometry, coal.Cylinder):
        across = np.sqrt(np.maximum(1 - axis**2, 0.0))
        return np.asarray(axis * geometry.halfLength + across * geometry.radius)
    if isinstance(geometry, coal.Box):
        return np.asarray(np.abs(rotation) @ geometry.halfSide)
    if isinstance(geometry, coal.Ellipsoid):
        return np.asarray(np.sqrt(rotation**2 @ geometry.radii**2))
    return None
