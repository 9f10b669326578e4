"""``levelled``: the table that a cloud shows, made horizontal and brought to its known height.

A calibration that is off by 5 degrees tilts the table by as much, and lifts it by 9 mm at 10 cm.
Gravity is known, and often the table's height; so of the six errors of a calibration three are seen
and taken back. What is left is a shift along the table and a turn about the vertical.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from planner.clouds.cloud import PointCloud
from planner.errors import ObjectError
from planner.spatial import FloatArray

STEEPEST = 0.94
"""Cosine of the largest tilt of a table: 20 degrees, four times the calibration error of the
issue that tables are levelled for."""

TRIES, SAMPLE = 300, 3000
"""Planes through three points that are tried, and points by which they are judged."""

LEAST_SHARE = 0.15
"""Share of the points that lie on a table at least; fewer are a box's top or nothing."""

MOST_BELOW = 0.03
"""Share of the points that may lie below it: outliers."""

AROUND = 0.03
"""Distance (m) around an object, beside its length, within which its table is looked for."""

FARTHEST = 0.03
"""Distance (m) of the table that is seen from the one that is known, beyond which one is wrong."""


def levelled(cloud: PointCloud, known: float | None = None) -> PointCloud:
    """The cloud with its table horizontal, ``table`` its height; unchanged where none is seen.

    Args:
        cloud: With the table's points in it; its ``table`` is not read.
        known: Height of the table's top, m, to which what is seen is shifted; that which is seen if
            None.

    Raises:
        ObjectError: The table is seen far from where it is known to be.
    """
    centre, reach = cloud.points.mean(axis=0), float(np.ptp(cloud.points, axis=0).max())
    around = cloud.past[np.linalg.norm(cloud.past - centre, axis=1) < reach + AROUND]
    seen = np.concatenate([cloud.points, around])  # where there is a mask, the table is around
    plane = _table_plane(seen, len(cloud), max(cloud.noise, 1e-3))
    if plane is None:
        return replace(cloud, table=known)
    normal, on = plane
    ground = seen[on].mean(axis=0)
    above = cloud.points[(cloud.points - ground) @ normal > FARTHEST / 2]
    middle = above.mean(axis=0) if len(above) else ground
    foot = middle - ((middle - ground) @ normal) * normal
    turn = _turn_to_vertical(normal)
    shift = 0.0 if known is None else known - float(foot[2])
    if abs(shift) > FARTHEST:
        raise ObjectError(
            f"the cloud's table is at z = {foot[2]:.3f} m, and the table is said to be at "
            f"{known:.3f} m; give the height of the one in the cloud (--table find in commands), "
            "or the cloud in the world's frame"
        )
    about = foot + np.array([0.0, 0.0, shift])
    tilt = np.degrees(np.arccos(np.clip(normal[2], -1.0, 1.0)))
    note = f"levelled on its table: turned by {tilt:.1f} degrees, raised by {1e3 * shift:.1f} mm"

    def moved(points: FloatArray) -> FloatArray:
        return np.asarray((points - foot) @ turn.T + about)

    return replace(
        cloud,
        points=moved(cloud.points),
        normals=None if cloud.normals is None else cloud.normals @ turn.T,
        views=moved(cloud.views),
        past=moved(cloud.past),
        table=float(about[2]),
        notes=(*cloud.notes, note),
    )


def _table_plane(
    points: FloatArray, count: int, noise: float
) -> tuple[FloatArray, NDArray[np.bool_]] | None:
    """Upward normal (3,) of the table and which points (n,) are on it; None without one.

    The first ``count`` points, the cloud, are not below it; beside a masked object a floor may be.
    """
    rng = np.random.default_rng(0)  # which points are tried; the same cloud, the same table
    order = rng.permutation(len(points))[:SAMPLE]
    some, own = points[order], order < count
    corners = some[rng.integers(0, len(some), (TRIES, 3))]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    normals = normals / np.maximum(lengths, 1e-12)[:, None] * np.sign(normals[:, 2:])
    sound = (lengths > 1e-6) & (normals[:, 2] > STEEPEST)
    if not sound.any():
        return None
    normals, corners = normals[sound], corners[sound]
    off = some @ normals.T - np.einsum("td,td->t", corners[:, 0], normals)
    width = 2.0 * noise
    score = (np.abs(off) < width).mean(axis=0) - 3.0 * (off[own] < -2.0 * width).mean(axis=0)
    best = int(np.argmax(score))
    normal, foot = normals[best], corners[best, 0]
    for _ in range(4):
        on = np.abs((points - foot) @ normal) < width
        if on.mean() < LEAST_SHARE:
            return None
        foot = points[on].mean(axis=0)
        centred = points[on] - foot
        normal = np.linalg.eigh(centred.T @ centred)[1][:, 0]
        normal = normal * np.sign(normal[2])
    below = ((points[:count] - foot) @ normal < -2.0 * width).mean()
    return None if below > MOST_BELOW or normal[2] < STEEPEST else (normal, on)


def _turn_to_vertical(normal: FloatArray) -> FloatArray:
    """Rotation (3, 3) that turns a unit vector (3,) near z onto z by the shortest way."""
    x, y, z = normal
    axis = np.array([[0.0, 0.0, -x], [0.0, 0.0, -y], [x, y, 0.0]])
    return np.asarray(np.eye(3) + axis + axis @ axis / (1.0 + z))
