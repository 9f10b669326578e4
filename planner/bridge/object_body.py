"""A body of an MJCF or URDF file as an object to grasp.

One primitive becomes that primitive. Several geoms, or meshes, become one mesh: side by side if
they are apart, united if they overlap or meet face to face. A mesh keeps its true triangles, though
MuJoCo itself would let its convex hull collide.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import mujoco
import numpy as np

from planner.bridge.geometry import mesh_triangles
from planner.bridge.load import compile_spec, load_spec
from planner.errors import NotFoundError, ObjectError
from planner.shapes import Box, Capsule, Cylinder, Ellipsoid, Mesh, Shape, Sphere
from planner.spatial import SE3, FloatArray, IntArray, pose_from_wxyz

FINENESS = 64
"""Points around a round geom that becomes triangles: 0.1 % of the radius from the true surface."""

GROWN = 2e-6
"""By how much (m) geoms grow that meet face to face: as they are, their union stays in pieces."""


@dataclass(frozen=True, kw_only=True)
class ObjectBody:
    """A body as an object.

    Attributes:
        shape: Its shape; the origin is the centre of mass of a uniform solid.
        mass: As the model has it, kg; 0 if the model gives none.
        T_body_object: Pose of the shape in the body's frame.
        center: Centre of mass (3,) of the model in the shape's frame, m: not the origin where the
            model's density is not uniform.
    """

    shape: Shape
    mass: float
    T_body_object: SE3
    center: FloatArray


def object_body(path: Path, name: str, *, repair: bool = False, strict: bool = False) -> ObjectBody:
    """The object that a body of a model file is; bodies below it are not part of it.

    Args:
        path: MJCF or URDF file.
        name: Of the body.
        repair: Whether to mend meshes that bound no solid however much that changes.
        strict: Whether to refuse meshes that would have to be mended, one by one; overlapping geoms
            are no fault of a model.

    Raises:
        ModelError: The file cannot be read.
        NotFoundError: No such body.
        ObjectError: The body has no geom with a volume, or its geoms do not make one solid.
    """
    model = compile_spec(load_spec(path), str(path))
    return object_in_model(model, name, f"body {name!r} of {path.name}", repair, strict)


def object_in_model(
    model: Any,
    name: str,
    what: str,
    repair: bool = False,
    strict: bool = False,
    frozen: Mapping[int, SE3] = MappingProxyType({}),
    hulls: bool = False,
) -> ObjectBody:
    """The same of a compiled ``mujoco.MjModel``.

    Args:
        model: The model.
        name: Of the body.
        what: What to call it in messages.
        repair: As ``object_body``.
        strict: As ``object_body``.
        frozen: Ids of further bodies that are part of it, and where they are in its frame: as if
            their joints were fixed there.
        hulls: Whether meshes are their convex hulls, as MuJoCo lets them collide.

    Raises:
        NotFoundError, ObjectError: As ``object_body``.
    """
    body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name)
    if body < 0:
        names = [model.body(i).name for i in range(1, model.nbody)]
        raise NotFoundError("body", name, [n for n in names if n])
    where = {body: SE3.Identity(), **frozen}
    own = [g for g in range(model.ngeom) if int(model.geom_bodyid[g]) in where]
    colliding = [g for g in own if model.geom_contype[g] or model.geom_conaffinity[g]]
    geoms = colliding or own  # a body that is only drawn is what is drawn
    if not geoms:
        raise ObjectError(f"{what} has no geom; name a body that carries one")
    if len(geoms) == 1 and int(model.geom_type[geoms[0]]) in _PRIMITIVES:
        g = geoms[0]
        shape = _PRIMITIVES[int(model.geom_type[g])](*(float(v) for v in model.geom_size[g]))
        return _placed(model, where, shape, _in_body(model, g, where))
    parts = [_triangles(model, g, what, _in_body(model, g, where), hulls) for g in geoms]
    try:
        mesh = _united(what, parts, repair, strict)
    except ObjectError:
        if len(parts) == 1:
            raise
        mesh = _united(what, [(_grown(v), f) for v, f in parts], repair, strict)
    return _placed(model, where, mesh, SE3(np.eye(3), mesh.offset))


def _placed(model: Any, where: Mapping[int, SE3], shape: Shape, T_body_object: SE3) -> ObjectBody:
    """A shape with the mass and the centre of mass that its bodies have in the model."""
    masses = model.body_mass[list(where)]
    mass = float(masses.sum())
    shares = masses / mass if mass else np.full(len(where), 1 / len(where))
    centers = np.array([pose.act(model.body_ipos[body]) for body, pose in where.items()])
    return ObjectBody(
        shape=shape,
        mass=mass,
        T_body_object=T_body_object,
        center=T_body_object.inverse().act(shares @ centers),
    )


def _in_body(model: Any, g: int, where: Mapping[int, SE3]) -> SE3:
    """Pose of a geom in the frame of the object's body."""
    pose = pose_from_wxyz(model.geom_pos[g], model.geom_quat[g])
    return where[int(model.geom_bodyid[g])] * pose


_TYPE = mujoco.mjtGeom
_PRIMITIVES: dict[int, Callable[[float, float, float], Shape]] = {
    int(_TYPE.mjGEOM_SPHERE): lambda r, _b, _c: Sphere(r),
    int(_TYPE.mjGEOM_BOX): lambda a, b, c: Box((2 * a, 2 * b, 2 * c)),
    int(_TYPE.mjGEOM_CYLINDER): lambda r, h, _c: Cylinder(r, 2 * h),
    int(_TYPE.mjGEOM_CAPSULE): lambda r, h, _c: Capsule(r, 2 * (h + r)),
    int(_TYPE.mjGEOM_ELLIPSOID): lambda a, b, c: Ellipsoid((2 * a, 2 * b, 2 * c)),
}


def _triangles(
    model: Any, g: int, what: str, pose: SE3, hulls: bool
) -> tuple[FloatArray, IntArray]:
    """Vertices (n, 3), m, in the body's frame, and faces (m, 3) of one geom at a pose in it."""
    import trimesh

    kind = int(model.geom_type[g])
    a, b, c = (float(v) for v in model.geom_size[g])
    if kind in (int(_TYPE.mjGEOM_MESH), int(_TYPE.mjGEOM_SDF)):
        vertices, faces = mesh_triangles(model, g)
        if hulls:
            hull = trimesh.Trimesh(vertices, faces, process=False).convex_hull
            vertices, faces = np.array(hull.vertices), np.array(hull.faces)
    else:
        if kind == int(_TYPE.mjGEOM_BOX):
            made = trimesh.creation.box((2 * a, 2 * b, 2 * c))
        elif kind == int(_TYPE.mjGEOM_CYLINDER):
            made = trimesh.creation.cylinder(a, 2 * b, sections=FINENESS)
        elif kind == int(_TYPE.mjGEOM_CAPSULE):
            made = trimesh.creation.capsule(2 * b, a, count=(FINENESS // 2, FINENESS))
            made.vertices[:, 2] -= (made.vertices[:, 2].min() + made.vertices[:, 2].max()) / 2
        elif kind in (int(_TYPE.mjGEOM_SPHERE), int(_TYPE.mjGEOM_ELLIPSOID)):
            made = trimesh.creation.uv_sphere(1.0, count=(FINENESS // 2, FINENESS))
            made.vertices *= [a, b, c] if kind == int(_TYPE.mjGEOM_ELLIPSOID) else a
        else:
            raise ObjectError(f"{what} has a plane or a height field, which is no solid; use a box")
        vertices, faces = np.array(made.vertices), np.array(made.faces)
    return vertices @ pose.rotation.T + pose.translation, faces


def _grown(vertices: FloatArray) -> FloatArray:
    """Vertices (n, 3), m, of a part whose farthest one is moved out by ``GROWN``."""
    out = vertices - vertices.mean(axis=0)
    grown: FloatArray = vertices + out * (GROWN / float(np.linalg.norm(out, axis=1).max()))
    return grown


def _united(
    what: str, parts: list[tuple[FloatArray, IntArray]], repair: bool, strict: bool
) -> Mesh:
    """One mesh of parts that are closed each."""
    if len(parts) == 1:
        return Mesh.from_triangles(*parts[0], name=what, repair=repair, strict=strict)
    solids = [
        Mesh.from_triangles(v, f, name=f"a geom of {what}", repair=repair, strict=strict)
        for v, f in parts
    ]
    starts = np.cumsum([0, *(len(s.vertices) for s in solids)])
    vertices = np.concatenate([s.vertices + s.offset for s in solids])
    faces = np.concatenate([s.faces + k for s, k in zip(solids, starts, strict=False)])
    mesh = Mesh.from_triangles(vertices, faces, name=what, repair=repair)
    told = [s.mended for s in solids]  # the exact union of a model's geoms is no mending
    return Mesh(mesh.vertices + mesh.offset, mesh.faces, mended="; ".join(filter(None, told)))
