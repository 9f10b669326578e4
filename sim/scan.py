"""``scan``: what depth cameras see of an object on a table, with the errors of real ones.

A camera casts the rays of its pixels at the true surface (``mj_multiRay``: exact for primitives,
the triangles of a mesh otherwise), so that a scan is the same on every machine and needs neither
OpenGL nor a GPU. A pair of eyes sees what both of them see: behind an edge there is a band without
depth.

Errors, in the order in which they arise (``DepthNoise``):

1. Lateral: a pixel sees what is a little beside it [1, 2].
2. Bleeding: a pixel at a jump of depth gets a depth between front and back [3].
3. Disparity: depth is z = f b / d, of focal length f, baseline b and disparity d. Noise of d is
   normal and correlated over the matching window; then d is rounded to a step [2, 4]. So the error
   of z grows with its square.
4. Dropouts: pixels that one eye does not see, grazing ones, and specks [1, 3].
5. Calibration: the camera is not where it is believed to be.

[1] Nguyen, Izadi, Lovell, Modeling Kinect sensor noise for improved 3D reconstruction and tracking,
3DIMPVT 2012: lateral 0.8 pixels, rising beyond 60 degrees of incidence; none beyond 80.
[2] Handa, Whelan, McDonald, Davison, A benchmark for RGB-D visual odometry, 3D reconstruction and
SLAM, ICRA 2014: lateral shift and disparity noise before rounding.
[3] Mallick, Das, Majumdar, Characterizations of noise in Kinect depth images: a review, IEEE
Sensors Journal 14 (2014): bleeding and zero-depth bands at edges, specks.
[4] Grunnet-Jepsen, Sweetser, Woodfill, Best-known-methods for tuning Intel RealSense D400 depth
cameras, 2018: z error = z^2 (subpixel) / (f b), subpixel 0.05 to 0.1; disparity in 1/32 pixel.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray
from pinocchio import exp3

from planner.arrays import check_fields, checked_number
from planner.bridge import compile_spec
from planner.clouds.cloud import PointCloud
from planner.clouds.files import DepthView, cloud_of_views, file_comments
from planner.errors import FileFormatError, ObjectError, TaskError, shown
from planner.objects import GraspObject, parse_object
from planner.shapes import Mesh
from planner.shapes.mesh import surface_triangles
from planner.shapes.solid import solid_geoms
from planner.spatial import SE3, FloatArray, pose_from_wxyz, pose_to_wxyz
from sim.scene.build import Truth

__all__ = [
    "Calibration",
    "DepthCamera",
    "DepthNoise",
    "Scan",
    "camera_places",
    "look_at",
    "scan",
    "scanned_truth",
    "write_scan",
]

TABLE = 0.5
"""Length and width (m) of the table around the object."""

AROUND = 1.7
"""Radius of what a scan keeps around the object, over the object's: table is seen on all sides."""

DISTANCE, ELEVATION = (0.45, 0.60), (30.0, 60.0)
"""Distance (m) and elevation (degrees) between which camera places are drawn: D400 cameras see from
0.3 m on, and arms look down at a table."""

WINDOW = 3
"""Half width (pixels) of the square in which an edge is looked for: stereo matches windows of 7."""

FARTHEST, MOST_TURN = 0.1, 0.5
"""Largest error of a calibration, m and rad: more is no calibration, but a wrong unit."""

MOST_VIEWS = 100
"""Most cameras of a scan: a cloud keeps 10,000 points, and a file a byte for the view of each."""

JUMP = 0.01
"""Least jump of depth (m) that counts as an edge."""


@dataclass(frozen=True, kw_only=True)
class DepthCamera:
    """A stereo camera.

    Attributes:
        width: Pixels.
        height: Pixels.
        focal: Focal length, pixels.
        baseline: Distance of the two eyes, m: that of a RealSense D415; the second eye is to the
            right.
    """

    width: int = 640
    height: int = 480
    focal: float = 600.0
    baseline: float = 0.055

    def __post_init__(self) -> None:
        """Check that all are positive."""
        check_fields(self, what="camera: ", above=0.0)

    @property
    def intrinsics(self) -> tuple[float, float, float, float]:
        """fx, fy, cx, cy, pixels."""
        return self.focal, self.focal, 0.5 * (self.width - 1), 0.5 * (self.height - 1)


@dataclass(frozen=True, kw_only=True)
class DepthNoise:
    """Errors of a depth camera; see the module.

    Attributes:
        depth: Standard deviation of depth at the object's distance, m.
        correlation: Standard deviation of the kernel over which disparity noise is correlated,
            pixels.
        step: Step of disparity, pixels; 0 for none.
        lateral: Standard deviation of the place that a pixel sees, pixels.
        bleeding: Probability (-) that a pixel at an edge gets a depth between.
        specks: Share of pixels without depth (-), in specks of some pixels.
        grazing: Angle of incidence (degrees) from which on, and at which all, depths drop out.
        shadow: Whether what the second eye does not see drops out.
    """

    depth: float = 0.002
    correlation: float = 1.0
    step: float = 1.0 / 32.0
    lateral: float = 0.5
    bleeding: float = 0.3
    specks: float = 0.02
    grazing: tuple[float, float] = (70.0, 85.0)
    shadow: bool = True

    def __post_init__(self) -> None:
        """Check every number."""
        check_fields(self, ("bleeding", "specks"), what="noise: ", least=0.0, most=1.0)
        check_fields(self, ("grazing",), what="noise: ", least=0.0, most=90.0, unit="degrees")
        check_fields(self, ("depth", "correlation", "step", "lateral"), what="noise: ", least=0.0)

    @classmethod
    def of(cls, depth: float) -> DepthNoise:
        """Errors of a camera with a noise of depth, m; an ideal camera for 0.

        Raises:
            TaskError: It is below 0 or more than 2 cm.
        """
        checked_number("noise", depth, least=0.0, most=0.02, unit="m", error=TaskError)
        if depth:
            return cls(depth=depth)
        return cls(depth=0.0, step=0.0, lateral=0.0, bleeding=0.0, specks=0.0,
                   grazing=(90.0, 90.0), shadow=False)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """How far cameras are from where they are believed to be; root mean squares.

    Directions and axes are drawn uniformly, lengths so that their components are normal. Turns are
    about the object: those about the camera also move it, which is part of ``shift``.

    Attributes:
        shift: Of all views together, m.
        turn: Of all views together, rad.
        view_shift: Of each view beside that, m.
        view_turn: Of each view beside that, rad.
    """

    shift: float = 0.0
    turn: float = 0.0
    view_shift: float = 0.0
    view_turn: float = 0.0

    def __post_init__(self) -> None:
        """Check that none is negative."""
        check_fields(self, ("shift", "view_shift"), what="calibration: ", least=0.0, most=FARTHEST)
        check_fields(self, ("turn", "view_turn"), what="calibration: ", least=0.0, most=MOST_TURN)

    def drawn(self, views: int, rng: np.random.Generator) -> list[SE3]:
        """Believed pose of what is seen in its true one, about the object, per view."""
        whole = _drawn(self.shift, self.turn, rng)
        return [whole * _drawn(self.view_shift, self.view_turn, rng) for _ in range(views)]


def _drawn(shift: float, turn: float, rng: np.random.Generator) -> SE3:
    parts = np.concatenate([[shift] * 3, [turn] * 3]) / math.sqrt(3.0)
    linear, angular = np.split(parts * rng.standard_normal(6), 2)
    return SE3(exp3(angular), linear)


@dataclass(frozen=True, kw_only=True, eq=False)
class Scan:
    """What cameras saw, and what was there.

    Attributes:
        views: Depth images, each with the pose where its camera is believed to be.
        truth: What was there.
        noise: Standard deviation of depth, m.
        on_object: Whether each pixel with a depth saw the object, (h, w) per view: for measuring.
        calibration: What was believed of each view's pose, about the object.
    """

    views: tuple[DepthView, ...]
    truth: Truth
    noise: float
    on_object: tuple[NDArray[np.bool_], ...] = field(repr=False)
    calibration: tuple[SE3, ...]

    def cloud(self, **more: Any) -> PointCloud:
        """Everything that was seen, the table too.

        Args:
            more: Arguments of ``PointCloud.create`` that are to be others: ``table``.
        """
        return cloud_of_views(self.views, **{"noise": self.noise or None, **more})


def scan(
    item: GraspObject,
    *,
    views: int | tuple[SE3, ...] = 1,
    noise: DepthNoise | float = 0.002,
    calibration: Calibration | None = None,
    camera: DepthCamera | None = None,
    T_world_object: SE3 | None = None,
    table: float = 0.0,
    seed: int = 0,
) -> Scan:
    """Look at an object on a table with a depth camera.

    Args:
        item: The object.
        views: How many, all around at equal angles from a drawn one, or the camera's poses
            (z ahead, y down).
        noise: Errors of the camera, or its noise of depth, m.
        calibration: How far it is from where it is believed to be; not at all if None.
        camera: Its image; defaults if None.
        T_world_object: Where the object is; in its first stable pose on the table if None.
        table: Height of the table's top, m.
        seed: Of all draws.

    Raises:
        TaskError: No view, or noise out of range.
        ObjectError: The object is not seen.
    """
    if not isinstance(item, GraspObject):
        raise TaskError(f"the object to scan is {shown(item)}; give parse_object('sphere:0.03')")
    rng = np.random.default_rng(np.random.SeedSequence([seed, 31]))
    camera = camera or DepthCamera()
    errors = noise if isinstance(noise, DepthNoise) else DepthNoise.of(noise)
    pose = item.resting_pose(table) if T_world_object is None else T_world_object
    number = len(views) if isinstance(views, tuple) else views
    if isinstance(number, bool) or not isinstance(number, int) or not 1 <= number <= MOST_VIEWS:
        raise TaskError(
            f"views is {shown(views)}; give poses or a number, at least one, at most {MOST_VIEWS}"
        )
    places = views if isinstance(views, tuple) else camera_places(views, pose.translation, rng)
    world = _World(item, pose, table)
    off = (calibration or Calibration()).drawn(len(places), rng)
    seen, masks = [], []
    about = SE3(np.eye(3), pose.translation)
    for place, error in zip(places, off, strict=True):
        depth, mine = world.seen(camera, place, errors, rng)
        believed = about * error * about.inverse() * place
        seen.append(
            DepthView(
                depth=depth,
                intrinsics=camera.intrinsics,
                T_world_camera=np.asarray(believed.homogeneous),
            )
        )
        masks.append(mine)
    if not any(mask.any() for mask in masks):
        raise ObjectError(f"no view sees {item.name}; let them look at it, from 0.3 to 1 m away")
    return Scan(
        views=tuple(seen),
        truth=Truth(object=item, T_world_object=pose, table_height=table),
        noise=errors.depth,
        on_object=tuple(masks),
        calibration=tuple(off),
    )


def camera_places(n: int, target: FloatArray, rng: np.random.Generator) -> tuple[SE3, ...]:
    """Poses of n cameras around a target (3,), m, at equal angles about the vertical."""
    first = rng.uniform(0.0, 2.0 * math.pi)
    places = []
    for k in range(n):
        around, up = first + 2.0 * math.pi * k / n, math.radians(rng.uniform(*ELEVATION))
        away = np.array([math.cos(around) * math.cos(up), math.sin(around) * math.cos(up),
                         math.sin(up)])  # fmt: skip
        places.append(look_at(target + rng.uniform(*DISTANCE) * away, target))
    return tuple(places)


def look_at(eye: FloatArray, target: FloatArray) -> SE3:
    """Pose of a camera at a place (3,) that looks at another (3,), m; its x axis is level.

    Raises:
        TaskError: Both are one place.
    """
    z = np.asarray(target, dtype=np.float64) - eye
    if not np.linalg.norm(z) > 0.0:
        raise TaskError(f"a camera at {shown(eye)} is where it is to look; put it outside")
    z /= np.linalg.norm(z)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x = x / np.linalg.norm(x) if np.linalg.norm(x) > 1e-9 else np.array([1.0, 0.0, 0.0])
    return SE3(np.stack([x, np.cross(z, x), z], axis=1), np.asarray(eye, dtype=np.float64))


class _World:
    """Object and table as rays meet them."""

    def __init__(self, item: GraspObject, pose: SE3, table: float) -> None:
        """Compile them."""
        spec = mujoco.MjSpec()
        half = 0.02
        x, y, _ = pose.translation
        spec.worldbody.add_geom(
            name="table",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=[TABLE / 2, TABLE / 2, half],
            pos=[x, y, table - half],
        )
        position, quaternion = pose_to_wxyz(pose)
        body = spec.worldbody.add_body(name="object", pos=position, quat=quaternion)
        if isinstance(item.shape, Mesh):
            vertices, faces = surface_triangles(item.shape)
            mesh = spec.add_mesh(name="object")
            mesh.uservert, mesh.userface = vertices.ravel(), faces.ravel()
            mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
            body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="object")
        else:
            (part,) = solid_geoms(item.shape)
            geom = body.add_geom()
            if part.vertices is not None and part.faces is not None:
                mesh = spec.add_mesh(name="object")
                mesh.uservert, mesh.userface = part.vertices.ravel(), part.faces.ravel()
                geom.type, geom.meshname = mujoco.mjtGeom.mjGEOM_MESH, "object"
            else:
                geom.type = getattr(mujoco.mjtGeom, f"mjGEOM_{part.kind.upper()}")
                geom.size = [*part.size, *(0.0,) * (3 - len(part.size))]
            geom.pos, geom.quat = pose_to_wxyz(part.T_object_geom)
        self._model = compile_spec(spec, f"a scan of {item.name}")
        self._data = mujoco.MjData(self._model)
        mujoco.mj_forward(self._model, self._data)
        self._table = self._model.geom("table").id
        self._centre, self._radius = pose.translation, item.shape.bounding_radius

    def cast(self, eye: FloatArray, rays: FloatArray) -> tuple[FloatArray, FloatArray, Any]:
        """Lengths (n,) of rays (n, 3) from a place, over their own; normals; geoms, -1 for none."""
        n = len(rays)
        geoms = np.full(n, -1, dtype=np.int32)
        reach, normals = np.full(n, -1.0), np.zeros(3 * n)
        flat = np.ascontiguousarray(rays, dtype=np.float64).ravel()
        mujoco.mj_multiRay(
            self._model, self._data, np.array(eye, dtype=np.float64), flat, None, True, -1, geoms,
            reach, normals, n, mujoco.mjMAXVAL,
        )  # fmt: skip
        return np.where(geoms < 0, np.nan, reach), normals.reshape(-1, 3), geoms

    def seen(
        self, camera: DepthCamera, place: SE3, noise: DepthNoise, rng: np.random.Generator
    ) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Depth image (h, w), m, and whether a pixel sees the object, of a camera at a pose."""
        fx, fy, cx, cy = camera.intrinsics
        depth = np.full((camera.height, camera.width), np.nan)
        mine = np.zeros(depth.shape, dtype=bool)
        middle = place.actInv(self._centre)
        if middle[2] <= self._radius:
            raise ObjectError(
                f"a camera is {middle[2]:.3f} m from the object along its axis; let it look at it, "
                "from outside"
            )
        reach = AROUND * self._radius / middle[2]
        rows, columns = (
            np.arange(
                max(0, math.floor(c + f * (m - reach))), min(n, math.ceil(c + f * (m + reach)))
            )
            for c, f, m, n in (
                (cy, fy, middle[1] / middle[2], camera.height),
                (cx, fx, middle[0] / middle[2], camera.width),
            )
        )
        if not (len(rows) and len(columns)):
            return depth, mine
        v, u = np.meshgrid(rows, columns, indexing="ij")
        at = np.stack([(u - cx) / fx, (v - cy) / fy, np.ones(u.shape)], axis=-1)
        if noise.lateral:
            shifts = rng.normal(0.0, noise.lateral, (*u.shape, 2)) / camera.focal
            at[..., :2] += shifts
        rays = at.reshape(-1, 3) @ place.rotation.T
        z, normals, geoms = self.cast(place.translation, rays)
        kept = self._kept(camera, place, noise, z, rays, normals, rng).reshape(u.shape)
        z = z.reshape(u.shape)
        z = _bled(z, noise, rng)
        z = _measured(z, camera, noise, float(middle[2]), rng)
        z[~kept | _specks(u.shape, noise, rng)] = np.nan
        depth[np.ix_(rows, columns)] = z
        mine[np.ix_(rows, columns)] = (geoms.reshape(u.shape) != self._table) & np.isfinite(z)
        return depth, mine

    def _kept(
        self, camera: DepthCamera, place: SE3, noise: DepthNoise, z: FloatArray, rays: FloatArray,
        normals: FloatArray, rng: np.random.Generator,
    ) -> NDArray[np.bool_]:  # fmt: skip
        """Which rays (n,) give a depth: seen by both eyes, and not at grazing angles."""
        met = np.isfinite(z)
        cosine = np.abs(np.einsum("nd,nd->n", rays, normals)) / np.linalg.norm(rays, axis=1)
        angle = np.degrees(np.arccos(np.clip(cosine, 0.0, 1.0)))
        begin, end = noise.grazing
        lost = (angle - begin) / max(end - begin, 1e-9)
        kept = met & ((angle <= begin) | (rng.random(len(z)) > lost))
        if noise.shadow:
            points = place.translation + np.where(met, z, 0.0)[:, None] * rays
            other = place.act(np.array([camera.baseline, 0.0, 0.0]))
            towards = points - other
            reach, _, _ = self.cast(other, towards)
            clear = 1e-3 / np.linalg.norm(towards, axis=1)  # 1 mm before the point
            kept &= ~(reach < 1.0 - clear)
        return np.asarray(kept)


def _bled(z: FloatArray, noise: DepthNoise, rng: np.random.Generator) -> FloatArray:
    """Depths (h, w), of which some at an edge are between front and back."""
    if not noise.bleeding:
        return z
    from scipy.ndimage import maximum_filter, minimum_filter

    filled = np.where(np.isfinite(z), z, np.nanmax(z, initial=0.0))
    front, back = minimum_filter(filled, WINDOW), maximum_filter(filled, WINDOW)
    between = front + rng.random(z.shape) * (back - front)
    bleeds = (back - front > JUMP) & (rng.random(z.shape) < noise.bleeding)
    return np.where(bleeds & np.isfinite(z), between, z)


def _measured(
    z: FloatArray, camera: DepthCamera, noise: DepthNoise, distance: float,
    rng: np.random.Generator,
) -> FloatArray:  # fmt: skip
    """Depths (h, w) by disparities with noise, of which depth has its own at a distance (m)."""
    if not (noise.depth or noise.step):
        return z
    from scipy.ndimage import gaussian_filter

    fb = camera.focal * camera.baseline
    field_ = rng.standard_normal(z.shape)
    if noise.correlation:
        field_ = gaussian_filter(field_, noise.correlation, mode="wrap")
        delta = np.zeros(z.shape)
        delta[0, 0] = 1.0
        kernel = gaussian_filter(delta, noise.correlation, mode="wrap")
        field_ /= np.sqrt((kernel**2).sum())
    disparity = fb / z + noise.depth * fb / distance**2 * field_
    if noise.step:
        disparity = np.round(disparity / noise.step) * noise.step
    return np.asarray(fb / np.maximum(disparity, 1e-3))


def _specks(
    shape: tuple[int, ...], noise: DepthNoise, rng: np.random.Generator
) -> NDArray[np.bool_]:
    """Pixels (h, w) that drop out in specks of two pixels' radius."""
    if not noise.specks:
        return np.zeros(shape, dtype=bool)
    from scipy.ndimage import gaussian_filter

    smooth = gaussian_filter(rng.standard_normal(shape), 2.0)
    return np.asarray(smooth > np.quantile(smooth, 1.0 - noise.specks))


def write_scan(found: Scan, path: Path | str) -> None:
    """Write a scan as a PLY cloud, binary: points, views, noise, and the truth for trials.

    Raises:
        FileFormatError: It cannot be written.
    """
    cloud = found.cloud(table=None)
    there = found.truth
    position, quaternion = pose_to_wxyz(there.T_world_object)
    truth = {
        "object": there.object.shape.spec,
        "mass": there.object.mass,
        "pose": [*map(float, position), *map(float, quaternion)],
        "table": there.table_height,
    }
    head = [
        "ply",
        "format binary_little_endian 1.0",
        *(f"comment view {x:.9g} {y:.9g} {z:.9g}" for x, y, z in cloud.views),
        *([f"comment noise {found.noise:.9g}"] if found.noise else []),
        f"comment {TRUTH} {json.dumps(truth)}",
        f"element vertex {len(cloud)}",
        *(f"property float {axis}" for axis in "xyz"),
        "property uchar view",
        "end_header\n",
    ]
    rows = np.empty(len(cloud), dtype=[("p", "<f4", 3), ("view", "u1")])
    rows["p"], rows["view"] = cloud.points, cloud.view_of
    try:
        Path(path).write_bytes("\n".join(head).encode() + rows.tobytes())
    except OSError as error:
        raise FileFormatError(f"cannot write {path}: {error.strerror}; name another") from error


TRUTH = "truth"
"""Word of the comment that holds what was there; planning does not read it."""


def scanned_truth(path: Path | str) -> Truth | None:
    """What a scan of ours was of; None of a cloud that does not say it.

    Raises:
        ObjectError: The file or the object cannot be read.
    """
    for words in file_comments(Path(path)):
        if words[:1] != (TRUTH,):
            continue
        try:
            data = json.loads(" ".join(words[1:]))
            pose = np.array(data["pose"], dtype=np.float64)
            return Truth(
                object=parse_object(str(data["object"]), mass=float(data["mass"])),
                T_world_object=pose_from_wxyz(pose[:3], pose[3:]),
                table_height=float(data["table"]),
            )
        except (ValueError, KeyError, TypeError) as error:
            raise ObjectError(f"{path}: its comment {TRUTH!r} is garbled: {error}") from error
    return None
