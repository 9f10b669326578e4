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
from planner.numerics.kernels import kernel
from planner.quality.wrench_hull import hull_faces
from planner.spatial import FloatArray

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


def _wrenches_by_numpy(
    points: FloatArray, inward: FloatArray, mu: float, length: float, sides: FloatArray
) -> FloatArray:
    """``pyramid_wrenches`` where it is not compiled."""
    least = np.argmin(np.abs(inward), axis=1)
    first = _cross(inward, np.eye(3)[least])
    first /= np.sqrt((first * first).sum(axis=1, keepdims=True))
    second = _cross(inward, first)
    one, two = (side[:, None, None] for side in sides.T)
    force = inward + mu * (one * first + two * second)
    wrenches = np.concatenate([force, _cross(points, force) / length], axis=2)
    return np.asarray(wrenches.reshape(-1, 6))


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Cross products along the last axis, a tenth of ``np.cross``'s time for a few."""
    return a[..., _NEXT] * b[..., _AFTER] - a[..., _AFTER] * b[..., _NEXT]


_NEXT, _AFTER = [1, 2, 0], [2, 0, 1]


@kernel(_wrenches_by_numpy)
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
    n = len(points)
    out = np.zeros((len(sides) * n, 6))
    first, second = np.zeros(3), np.zeros(3)
    for i in range(n):
        x, y, z = inward[i, 0], inward[i, 1], inward[i, 2]
        # normal x e, with e the coordinate axis that is least aligned with it
        if abs(x) <= abs(y) and abs(x) <= abs(z):
            first[0], first[1], first[2] = 0.0, z, -y
        elif abs(y) <= abs(z):
            first[0], first[1], first[2] = -z, 0.0, x
        else:
            first[0], first[1], first[2] = y, -x, 0.0
        size = np.sqrt(first[0] * first[0] + first[1] * first[1] + first[2] * first[2])
        for j in range(3):
            first[j] /= size
        second[0] = y * first[2] - z * first[1]
        second[1] = z * first[0] - x * first[2]
        second[2] = x * first[1] - y * first[0]
        for k in range(len(sides)):
            row = k * n + i
            for j in range(3):
                tangential = sides[k, 0] * first[j] + sides[k, 1] * second[j]
                out[row, j] = inward[i, j] + mu * tangential
            for j in range(3):
                after, last = (j + 1) % 3, (j + 2) % 3
                moment = points[i, after] * out[row, last] - points[i, last] * out[row, after]
                out[row, 3 + j] = moment / length
    return out


def first_apart(directions: FloatArray, count: int) -> list[int]:
    """The first up to ``count`` of unit directions (k, 6) that are at least 20 degrees apart."""
    chosen: list[int] = []
    far = np.ones(len(directions), dtype=bool)
    while len(chosen) < count and far.any():
        chosen.append(int(far.argmax()))
        far &= directions @ directions[chosen[-1]] < APART
        far[chosen[-1]] = False
    return chosen
