"""``lidded``: what cameras saw of a hollow through its mouth, as a lid on the mouth.

Walls thinner than the camera's noise come out as neither solid nor surface. Fingers grasp a cup
from outside, where it is the solid that its lid makes of it. A contact on a lid touches nothing.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from planner.clouds.cloud import PointCloud, estimated_normals
from planner.spatial import FloatArray

RIM, RIM_NOISE = 0.004, 2.0
"""Height (m) of what counts as the rim, below the top, and its least over the noise (-)."""

DEEP, DEEP_SHARE = 0.008, 0.25
"""Depth (m) below the mouth, and its share of the object's height, from which on a point is in a
hollow: a round top is not."""

HOLLOW = 0.05
"""Share of the points (-) from which on there is a hollow: fewer are bleeding edges."""


SPACING = 0.0015
"""Distance (m) of points of a lid: that of a camera's pixels at an object."""

OPEN = 1.2
"""Angle (rad) without a rim, as seen from the middle of a mouth, from which on it is none, but a
corner that is open to a side: 70 degrees."""


def lidded(cloud: PointCloud) -> tuple[PointCloud, FloatArray]:
    """A prepared cloud, with a lid instead of what cameras saw through its mouth from above.

    A point is in the hollow if its ray of sight comes in through the hull of the rim.

    Returns:
        The cloud, and the points (k, 3) of the lid, m, none if it is not hollow.
    """
    if cloud.table is None or not len(cloud.views):
        return cloud, np.zeros((0, 3))
    points = cloud.points
    top = float(np.percentile(points[:, 2], 98.0)) - cloud.noise
    least = max(RIM, RIM_NOISE * cloud.noise)
    rim = points[points[:, 2] > top - least, :2]
    inside, mouth = through(rim, top, points, cloud.views[cloud.view_of])
    inside &= points[:, 2] < top - least
    deep = inside & (points[:, 2] < top - max(DEEP, DEEP_SHARE * (top - cloud.table)))
    if deep.mean() < HOLLOW or _gap(rim - mouth[deep].mean(axis=0)) > OPEN:
        return cloud, np.zeros((0, 3))
    low, high = rim.min(axis=0), rim.max(axis=0)
    axes = (np.arange(low[i], high[i], SPACING) for i in range(2))
    flat = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    flat = flat[_within(rim, flat)]
    lid = np.column_stack([flat, np.full(len(flat), top)])
    # for every camera that looks in: some rays into a hollow come back without a depth
    looks_in = np.unique(cloud.view_of[inside])
    outside = ~through(rim, top, cloud.past, cloud.views[cloud.past_of])[0]  # a thin floor's
    note = f"{inside.sum()} points are in a hollow, which counts as filled"
    filled = replace(
        cloud,
        points=np.vstack([points[~inside], *[lid] * len(looks_in)]),
        view_of=np.concatenate([cloud.view_of[~inside], np.repeat(looks_in, len(lid))]),
        past=cloud.past[outside],
        past_of=cloud.past_of[outside],
        notes=(*cloud.notes, note),
    )
    return replace(filled, normals=estimated_normals(filled)), lid


def _gap(around: FloatArray) -> float:
    """Largest angle (rad) between neighbours of points (n, 2) as seen from the origin."""
    angles = np.sort(np.arctan2(around[:, 1], around[:, 0]))
    return float(np.diff(angles, append=angles[:1] + 2.0 * np.pi).max())


def through(
    rim: FloatArray, top: float, points: FloatArray, eyes: FloatArray
) -> tuple[NDArray[np.bool_], FloatArray]:
    """Whether rays from eyes above to points (n, 3) go through a rim, and where, (n, 2)."""
    below = (points[:, 2] < top) & (eyes[:, 2] > top)
    way = (top - points[:, 2]) / np.where(below, eyes[:, 2] - points[:, 2], 1.0)
    mouth = points[:, :2] + way[:, None] * (eyes - points)[:, :2]
    return below & _within(rim, mouth), mouth


def _within(ring: FloatArray, points: FloatArray) -> NDArray[np.bool_]:
    """Whether points (n, 2) are in the convex hull of others."""
    from scipy.spatial import Delaunay, QhullError

    try:
        return np.asarray(Delaunay(ring).find_simplex(points) >= 0)
    except (QhullError, ValueError):  # a rim without an area
        return np.zeros(len(points), dtype=bool)
