"""The directions in which a grasp resists least, quickly: what an optimiser should work on.

The hull of unit contact wrenches (normal forces sum to 1, torques over ``length``) is taken with
coarse friction pyramids; the outward normals of its nearest faces are the directions. The round
cones resist a little more in each of them, and what they resist at least is epsilon: bounds that
are proven come from ``planner.quality.interval``.
"""

from __future__ import annotations

import numpy as np

from planner.contacts import cone_edges
from planner.spatial import FloatArray

__all__ = ["first_apart", "weakest_directions", "wrench_faces"]

EDGES = 4
"""Sides of the pyramids: a hull takes 1 ms with four, 4 ms with eight."""

APART = float(np.cos(np.deg2rad(20.0)))
"""Directions closer than this cosine are one."""


def weakest_directions(
    points: FloatArray, inward: FloatArray, mu: float, length: float, count: int
) -> FloatArray:
    """Up to ``count`` unit directions (k, 6), weakest first, at least 20 degrees apart.

    None where the wrenches span no volume.

    Args:
        points: Contact points (n, 3) about the reference point, m.
        inward: Unit normals into the object (n, 3).
        mu: Friction (-).
        length: Characteristic length, m.
        count: How many.
    """
    faces = wrench_faces(points, inward, mu, length)[:, :6]
    return faces[first_apart(faces, count)]


def wrench_faces(points: FloatArray, inward: FloatArray, mu: float, length: float) -> FloatArray:
    """Faces (k, 7) of the hull, nearest first: outward unit normal, minus its distance.

    None where the wrenches span no volume. Arguments are those of ``weakest_directions``.
    """
    from scipy.spatial import ConvexHull, QhullError  # here, since SciPy loads slowly

    least = np.argmin(np.abs(inward), axis=1)
    first = np.cross(inward, np.eye(3)[least])
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(inward, first)
    _, *tangential, _ = cone_edges(1.0, 0.0, EDGES)
    one, two = (side[:, None, None] for side in tangential)
    force = inward + mu * (one * first + two * second)
    wrenches = np.concatenate([force, np.cross(points / length, force)], axis=2).reshape(-1, 6)
    try:
        faces = np.asarray(ConvexHull(wrenches).equations)
    except QhullError:
        return np.zeros((0, 7))
    return faces[np.argsort(-faces[:, 6], kind="stable")]


def first_apart(directions: FloatArray, count: int) -> list[int]:
    """The first up to ``count`` of unit directions (k, 6) that are at least 20 degrees apart."""
    chosen: list[int] = []
    far = np.ones(len(directions), dtype=bool)
    while len(chosen) < count and far.any():
        chosen.append(int(far.argmax()))
        far &= directions @ directions[chosen[-1]] < APART
        far[chosen[-1]] = False
    return chosen
