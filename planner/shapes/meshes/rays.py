"""Where lines pass through the triangles of a mesh: coal's tree finds them, closed form measures.

Unlike a march through the smooth distance this finds walls of any thickness.
"""

from __future__ import annotations

from typing import Any

import coal
import numpy as np

from planner.spatial import FloatArray, IntArray

NEEDLE = 1e-7
"""Radius (m) of the capsule by which coal looks for triangles."""

MOST = 1000
"""Most triangles on a line that coal tells."""


def pierced(
    tree: Any,
    corners: FloatArray,
    starts: FloatArray,
    directions: FloatArray,
    length: float,
    *,
    least: float,
) -> tuple[IntArray, FloatArray, IntArray]:
    """Triangles that rays pass through: number of the ray, depth (m), triangle; (k,) each.

    Sorted by ray, then by depth. A ray through an edge meets one of its triangles, both, or by
    rounding none.

    Args:
        tree: The triangles as a coal geometry (``coal_tree``).
        corners: The same (m, 3 corners, 3), m.
        starts: Where rays begin (n, 3), m.
        directions: Unit vectors (n, 3).
        length: Of the rays, m.
        least: Depth (m) from which on they are looked at: they may begin on the surface.
    """
    rays, triangles = _near(tree, starts, directions, length)
    a, b, c = (corners[triangles, k] for k in range(3))
    along, origin = directions[rays], starts[rays]
    # Moeller and Trumbore, "Fast, minimum storage ray/triangle intersection", 1997
    across = np.cross(along, c - a)
    volume = np.einsum("kd,kd->k", b - a, across)
    inverse = 1.0 / np.where(volume != 0.0, volume, np.inf)
    to_start = origin - a
    u = np.einsum("kd,kd->k", to_start, across) * inverse
    turned = np.cross(to_start, b - a)
    v = np.einsum("kd,kd->k", along, turned) * inverse
    depth = np.einsum("kd,kd->k", c - a, turned) * inverse
    met = (volume != 0.0) & (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0)
    met &= (depth >= least) & (depth <= length)
    rays, triangles, depth = rays[met], triangles[met], depth[met]
    order = np.lexsort((triangles, depth, rays))
    return rays[order], depth[order], triangles[order]


def _near(
    tree: Any, starts: FloatArray, directions: FloatArray, length: float
) -> tuple[IntArray, IntArray]:
    """Pairs of ray and triangle (k,) that a thin capsule along the ray touches."""
    request, result = coal.CollisionRequest(), coal.CollisionResult()
    request.num_max_contacts = MOST
    needle, here, pose = (
        coal.Capsule(NEEDLE, length),
        coal.Transform3s.Identity(),
        coal.Transform3s(),
    )
    rotations = _along_z(directions)
    rays, triangles = [], []
    for i, middle in enumerate(starts + length / 2 * directions):
        pose.setRotation(rotations[i])
        pose.setTranslation(middle)
        result.clear()
        coal.collide(tree, here, needle, pose, request, result)
        found = [result.getContact(k).b1 for k in range(result.numContacts())]
        rays += [i] * len(found)
        triangles += found
    return np.array(rays, dtype=np.int64), np.array(triangles, dtype=np.int64)


def _along_z(directions: FloatArray) -> FloatArray:
    """Rotations (n, 3, 3) whose third columns are unit vectors (n, 3)."""
    aside = np.eye(3)[np.argmin(np.abs(directions), axis=1)]
    x = np.cross(aside, directions)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    return np.stack([x, np.cross(directions, x), directions], axis=2)
