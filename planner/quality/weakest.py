"""The directions in which a grasp resists least, quickly: what an optimiser should work on.

The hull of unit contact wrenches (normal forces sum to 1, torques over ``length``) is taken with
coarse friction pyramids; the outward normals of its nearest faces are the directions. The round
cones resist a little more in each of them, and what they resist at least is epsilon: bounds that
are proven come from ``planner.quality.interval``.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from planner.contacts import cone_edges
from planner.quality.wrench_hull import hull_faces
from planner.spatial import FloatArray, cross

EDGES = 4
"""Sides of the pyramids: Qhull takes 1 ms with four, 4 ms with eight."""

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
    """Faces (k, 7) of the hull, nearest first, each once: outward unit normal, minus its distance.

    None where the wrenches span no volume. Arguments are those of ``weakest_directions``.
    """
    return hull_faces(pyramid_wrenches(points, inward, float(mu), float(length), sides_of(EDGES)))


@lru_cache(4)
def sides_of(edges: int) -> FloatArray:
    """Tangential force (k, 2) of each edge of a pyramid at a friction of 1."""
    sides = np.ascontiguousarray(cone_edges(1.0, 0.0, edges)[1:3].T)
    sides.flags.writeable = False
    return sides


def pyramid_wrenches(
    points: FloatArray, inward: FloatArray, mu: float, length: float, sides: FloatArray
) -> FloatArray:
    """Wrenches (k n, 6) of the edges of friction pyramids, torques over ``length``.

    Args:
        points: (n, 3), m.
        inward: Unit normals (n, 3).
        mu: Friction (-).
        length: m.
        sides: Tangential force (k, 2) of each edge at a friction of 1.
    """
    least = np.argmin(np.abs(inward), axis=1)
    first = cross(inward, np.eye(3)[least])
    first /= np.sqrt((first * first).sum(axis=1, keepdims=True))
    second = cross(inward, first)
    one, two = (side[:, None, None] for side in sides.T)
    force = inward + mu * (one * first + two * second)
    wrenches = np.concatenate([force, cross(points, force) / length], axis=2)
    return np.asarray(wrenches.reshape(-1, 6))


def first_apart(directions: FloatArray, count: int) -> list[int]:
    """The first up to ``count`` of unit directions (k, 6) that are at least 20 degrees apart."""
    chosen: list[int] = []
    far = np.ones(len(directions), dtype=bool)
    while len(chosen) < count and far.any():
        chosen.append(int(far.argmax()))
        far &= directions @ directions[chosen[-1]] < APART
        far[chosen[-1]] = False
    return chosen
