"""Where the camera stands: a view that is free of what would hide hand and object, and follows.

The direction is chosen once for a picture or film: rays are cast from some directions at some
moments, and the one is taken from which most of the object and of every finger's tip is seen. That
needs no OpenGL. The distance is the least at which object and fingers stay in the picture at every
moment; it and the point that is looked at, their middle, change smoothly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np
from scipy.ndimage import gaussian_filter1d, maximum_filter1d

from planner.spatial import FloatArray, IntArray

__all__ = ["FIELD_OF_VIEW_DEG", "Subject", "View", "choose_views", "sees"]

FIELD_OF_VIEW_DEG = 32.0
"""Vertical field of view of every camera, degrees: as a lens that does not distort a hand."""

AZIMUTHS_DEG = tuple(float(a) for a in range(0, 360, 20))
ELEVATIONS_DEG = (-20.0, -35.0)
"""Directions that are tried, degrees: MuJoCo's elevation is negative for a look from above."""

RAYS = (40, 30)
"""Rays across and down the picture by which it is found out what is seen."""

MOMENTS = 3
"""Moments of a film at which it is found out."""

MARGIN = 1.12
"""Room around object and fingers: 1 for none."""

TIP_SHARE = 0.6
"""How much the tips count in the choice of a direction; the object counts the rest."""

CLUTTER = 0.6
"""What a picture that is full of forearm or arm costs, as a share of the best score."""

ENOUGH = 0.5
"""Share of a tip, of what its best direction shows, at which it counts as seen."""

FOLLOW_S = 0.5
"""Standard deviation (s) of the smoothing of the point that is looked at."""

NEAREST = 0.25
"""Least distance (m) of the camera."""


@dataclass(frozen=True, kw_only=True)
class Subject:
    """What a picture is about.

    Attributes:
        object_body: Body id of the object.
        tips: Body ids of the tips of the fingers that take part.
        bodies: Body ids of object, fingers and palm: what has to be in the picture.
    """

    object_body: int
    tips: tuple[int, ...]
    bodies: tuple[int, ...]


@dataclass(frozen=True, kw_only=True)
class View:
    """A place of the camera, as MuJoCo's free camera has it.

    Attributes:
        lookat: Point (3,) in the middle of the picture, m.
        distance: From there to the camera, m.
        azimuth: Degrees.
        elevation: Degrees, negative from above.
    """

    lookat: FloatArray
    distance: float
    azimuth: float
    elevation: float

    @property
    def camera(self) -> Any:
        """``mujoco.MjvCamera``."""
        camera = mujoco.MjvCamera()
        camera.type = mujoco.mjtCamera.mjCAMERA_FREE
        camera.lookat[:] = self.lookat
        camera.distance = self.distance
        camera.azimuth, camera.elevation = self.azimuth, self.elevation
        return camera

    @property
    def axes(self) -> FloatArray:
        """Columns right, up and forwards of the picture, (3, 3), world."""
        a, e = np.deg2rad((self.azimuth, self.elevation))
        forwards = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
        right = np.array([np.sin(a), -np.cos(a), 0.0])
        return np.column_stack([right, np.cross(right, forwards), forwards])


def choose_views(
    model: Any,
    poses: Sequence[FloatArray],
    subject: Subject,
    aspect: float,
    *,
    follow: float | None,
) -> list[View]:
    """A view for each of some moments, all in one direction.

    Args:
        model: ``mujoco.MjModel``.
        poses: qpos (nq,) of every moment; at least one.
        subject: What is to be seen.
        aspect: Width of the picture over its height.
        follow: Moments per second of a film, which the camera follows smoothly; None where every
            moment is a picture of its own.
    """
    data = mujoco.MjData(model)
    clouds = [_points(model, data, qpos, subject) for qpos in poses]
    lookat = np.array([_middle(cloud) for cloud in clouds])
    if follow is not None:
        lookat = gaussian_filter1d(lookat, FOLLOW_S * follow, axis=0, mode="nearest")
    moments = np.unique(np.linspace(0, len(poses) - 1, MOMENTS + 1).round().astype(int)[1:])
    direction = _best_direction(model, data, [poses[i] for i in moments], subject, aspect)
    distances = [
        _distance(cloud - point, direction, aspect)
        for cloud, point in zip(clouds, lookat, strict=True)
    ]
    if follow is not None:
        reach = int(2 * FOLLOW_S * follow)
        widest = maximum_filter1d(np.array(distances), 2 * reach + 1, mode="nearest")
        distances = gaussian_filter1d(widest, FOLLOW_S * follow, mode="nearest").tolist()
    return [
        replace(direction, lookat=point, distance=distance)
        for point, distance in zip(lookat, distances, strict=True)
    ]


def _best_direction(
    model: Any, data: Any, poses: Sequence[FloatArray], subject: Subject, aspect: float
) -> View:
    """The direction from which most is seen, each part as a share of what its best direction has.

    What is seen of a part is its area, so that a camera that has to stand off counts as much.
    """
    directions = [
        View(lookat=np.zeros(3), distance=1.0, azimuth=azimuth, elevation=elevation)
        for elevation in ELEVATIONS_DEG
        for azimuth in AZIMUTHS_DEG
    ]
    parts = (subject.object_body, *subject.tips)
    moving = set(np.flatnonzero(model.body_weldid).tolist())
    beside = sorted(moving - set(subject.bodies))
    areas = np.zeros((len(directions), len(poses), len(parts)))
    clutter = np.zeros((len(directions), len(poses)))
    for k, qpos in enumerate(poses):
        cloud = _points(model, data, qpos, subject)
        middle = _middle(cloud)
        for i, direction in enumerate(directions):
            distance = _distance(cloud - middle, direction, aspect)
            view = replace(direction, lookat=middle, distance=distance)
            seen = sees(model, data, view, aspect)
            clutter[i, k] = np.isin(seen, beside).mean()
            areas[i, k] = [distance**2 * np.count_nonzero(seen == body) for body in parts]
    shares = areas / np.maximum(areas.max(axis=0), 1e-9)
    tips = np.sqrt(shares[..., 1:]).mean(
        axis=(1, 2)
    )  # the root: one tip hidden is worse than two half hidden
    score = (1 - TIP_SHARE) * shares[..., 0].mean(axis=1) + TIP_SHARE * tips
    score -= CLUTTER * clutter.mean(axis=1)
    return directions[int(np.argmax(score))]


def sees(model: Any, data: Any, view: View, aspect: float) -> IntArray:
    """Body ids that a grid of rays meets, (rays,); -1 where there is nothing.

    Args:
        model: ``mujoco.MjModel``.
        data: ``mujoco.MjData`` with kinematics computed.
        view: From where.
        aspect: Width of the picture over its height.
    """
    across, down = RAYS
    half = np.tan(np.deg2rad(FIELD_OF_VIEW_DEG / 2))
    x, y = np.meshgrid(np.linspace(-1, 1, across) * half * aspect, np.linspace(-1, 1, down) * half)
    rays = np.column_stack([x.ravel(), y.ravel(), np.ones(x.size)]) @ view.axes.T
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    geoms, distances = np.full(len(rays), -1, dtype=np.int32), np.zeros(len(rays))
    eye = view.lookat - view.distance * view.axes[:, 2]
    groups = np.array(mujoco.MjvOption().geomgroup, dtype=np.uint8)
    mujoco.mj_multiRay(
        model, data, eye, rays.ravel(), groups, True, -1, geoms, distances, None, len(rays), 10.0
    )
    bodies = np.where(geoms < 0, -1, model.geom_bodyid[geoms])
    return np.asarray(bodies, dtype=np.int64)


def _points(model: Any, data: Any, qpos: FloatArray, subject: Subject) -> FloatArray:
    """Corners (n, 3) of the boxes around the geoms of the subject's bodies, world, m."""
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    geoms = np.flatnonzero(np.isin(model.geom_bodyid, subject.bodies))
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    boxes = model.geom_aabb[geoms].reshape(-1, 2, 3)
    corners = boxes[:, :1] + signs * boxes[:, 1:]  # (geoms, 8, 3)
    turned = np.einsum("gij,gkj->gki", data.geom_xmat[geoms].reshape(-1, 3, 3), corners)
    return np.asarray((turned + data.geom_xpos[geoms][:, None]).reshape(-1, 3))


def _middle(points: FloatArray) -> FloatArray:
    """Middle (3,) of the box around points (n, 3)."""
    return np.asarray((points.max(axis=0) + points.min(axis=0)) / 2)


def _distance(points: FloatArray, view: View, aspect: float) -> float:
    """Least distance (m) from the middle at which all points (n, 3) about it are in the picture."""
    x, y, depth = (points @ view.axes).T
    half = np.tan(np.deg2rad(FIELD_OF_VIEW_DEG / 2)) / MARGIN
    needed = np.maximum(np.abs(x) / (half * aspect), np.abs(y) / half) - depth
    return max(NEAREST, float(needed.max()))
