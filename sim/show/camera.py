"""Where the camera stands: a view that is free of what would hide hand and object, and follows.

The direction is chosen once for a picture or film: rays are cast from some directions at some
moments, and the one is taken from which most of the object and of every finger's tip is seen. That
needs no OpenGL. The distance is the least at which object and fingers stay in the picture at every
moment; it and the point that is looked at, their middle, change smoothly.

What is only to be looked at: sky, lights, ground, and a mark by which a turn is seen.

Nothing here has mass or collides, so that a scene moves as it would without it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d, maximum_filter1d

from planner.spatial import FloatArray, IntArray

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


OBJECT_MATERIAL = "object"
"""Name of the object's material and texture."""

OBJECT_RGB, SHADE_RGB, MARK_RGB = (118, 176, 126), (66, 128, 88), (252, 246, 226)
"""The object: its two greens by quadrants of heading, and the mark at heading zero; 0 to 255."""

MARK_DEG = 9.0
"""Half the width of the mark, degrees of heading."""

TEXELS = 128
"""Width of a side of the object's texture."""

EXTENT = 0.30
"""Size (m) of what matters in the picture; MuJoCo scales shadows and clipping by it."""

FLOOR_DEPTH = 0.5
"""How far (m) below the object the floor is drawn where there is no table."""

LAMPS = {
    "key lamp": ((0.32, -0.42, -1.0), (0.42, 0.41, 0.38), True),
    "fill lamp": ((0.8, 0.9, -0.8), (0.16, 0.18, 0.21), False),
}
"""Name -> direction of the light for a camera that looks along +x (y is left), brightness, and
whether it casts shadows: the key lamp stands on the left behind the camera."""

_RGB = int(mujoco.mjtTextureRole.mjTEXROLE_RGB)


def add_scenery(
    spec: Any,
    focus: FloatArray,
    toward_camera: FloatArray,
    table_height: float | None,
    scale: float = 1.0,
) -> None:
    """Add sky, lights, and a floor where no table is; place the viewer's first camera.

    Args:
        spec: ``mujoco.MjSpec``.
        focus: Point (3,) to look at before the lift, m.
        toward_camera: Direction (3,) from there to where a person would stand, world.
        table_height: Height of the table's top, m; None for no table.
        scale: How much more than object and hand is to be seen, a factor on the distance.
    """
    look = spec.visual
    look.global_.fovy = FIELD_OF_VIEW_DEG
    look.global_.azimuth = float(np.rad2deg(np.arctan2(-toward_camera[1], -toward_camera[0])))
    look.global_.elevation = -20.0
    look.quality.shadowsize = 4096
    look.map.znear, look.map.shadowclip = 0.02, 4.5
    look.headlight.ambient = (0.40, 0.40, 0.41)
    look.headlight.diffuse = (0.36, 0.36, 0.36)
    look.headlight.specular = (0.05, 0.05, 0.05)
    spec.stat.center, spec.stat.extent = focus, scale * EXTENT
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=(0.93, 0.95, 0.97),
        rgb2=(0.70, 0.76, 0.83),
        width=256,
        height=256,
    )
    for name, (_, brightness, shadow) in LAMPS.items():
        position, direction = lamp_at(name, focus, look.global_.azimuth)
        spec.worldbody.add_light(
            name=name,
            pos=position,
            dir=direction,
            diffuse=brightness,
            specular=(0.25, 0.25, 0.25) if shadow else (0.0, 0.0, 0.0),
            type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
            castshadow=shadow,
        )
    if table_height is None:
        spec.worldbody.add_geom(
            name="floor",
            type=mujoco.mjtGeom.mjGEOM_PLANE,
            size=(0, 0, 1),
            pos=(0, 0, focus[2] - FLOOR_DEPTH),
            contype=0,
            conaffinity=0,
            rgba=(0.86, 0.86, 0.85, 1.0),
        )


def lamp_at(name: str, focus: FloatArray, azimuth: float) -> tuple[FloatArray, FloatArray]:
    """Where one of ``LAMPS`` stands, and the direction (3,) of its light.

    Args:
        name: Which.
        focus: Point (3,) that is looked at, m.
        azimuth: Of the camera, degrees.
    """
    c, s = np.cos(np.deg2rad(azimuth)), np.sin(np.deg2rad(azimuth))
    x, y, z = LAMPS[name][0]
    direction = np.array([c * x - s * y, s * x + c * y, z])
    return focus - direction, direction / np.linalg.norm(direction)


def add_object_material(spec: Any) -> None:
    """Add a material whose texture tells the heading of what wears it.

    MuJoCo puts a cube texture on any geom as seen from its centre: the colour of a point is that of
    its direction. The mark is a sector about +x, from pole to pole, and the quadrants alternate.
    """
    texture = spec.add_texture(
        name=OBJECT_MATERIAL,
        type=mujoco.mjtTexture.mjTEXTURE_CUBE,
        width=TEXELS,
        height=6 * TEXELS,
        nchannel=3,
    )
    texture.data = _heading_texture().tobytes()
    material = spec.add_material(name=OBJECT_MATERIAL, specular=0.15, shininess=0.3)
    material.textures[_RGB] = OBJECT_MATERIAL


def _heading_texture() -> NDArray[np.uint8]:
    """Pixels (6 sides x rows, columns, 3) in MuJoCo's order: right, left, up, down, front, back."""
    at = (2 * np.arange(TEXELS) + 1) / TEXELS - 1
    s, t = np.meshgrid(at, at)
    one = np.ones_like(s)
    # OpenGL's cube map: which direction the texel (s, t) of a side lies in
    sides = [
        (one, -t, -s),
        (-one, -t, s),
        (s, one, t),
        (s, -one, -t),
        (s, -t, one),
        (-s, -t, -one),
    ]
    out = np.empty((6, TEXELS, TEXELS, 3), dtype=np.uint8)
    for pixels, (x, y, z) in zip(out, sides, strict=True):
        heading = np.rad2deg(np.arctan2(y, x))
        odd = (np.floor(heading / 90.0) % 2).astype(bool)
        pixels[:] = np.where(odd[..., None], SHADE_RGB, OBJECT_RGB)
        pixels[np.abs(heading) < MARK_DEG] = MARK_RGB
        del z
    return out.reshape(6 * TEXELS, TEXELS, 3)
