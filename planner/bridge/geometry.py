"""The colliding geometries of a compiled MuJoCo model as coal geometries on Pinocchio joints."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import coal
import mujoco
import numpy as np

from planner.bridge.pinocchio_model import body_name
from planner.errors import ModelError
from planner.shapes.convex import convex_geometry
from planner.spatial import SE3, FloatArray, pose_from_wxyz

_TYPE = {
    int(mujoco.mjtGeom.mjGEOM_SPHERE): "sphere",
    int(mujoco.mjtGeom.mjGEOM_CAPSULE): "capsule",
    int(mujoco.mjtGeom.mjGEOM_CYLINDER): "cylinder",
    int(mujoco.mjtGeom.mjGEOM_BOX): "box",
    int(mujoco.mjtGeom.mjGEOM_ELLIPSOID): "ellipsoid",
    int(mujoco.mjtGeom.mjGEOM_MESH): "mesh",
}


@dataclass(frozen=True, kw_only=True)
class LinkGeometry:
    """One colliding geometry of a hand.

    Attributes:
        name: Name of the MuJoCo geom.
        body: Name of the body that carries it.
        joint_id: Pinocchio joint it moves with (0: the base).
        T_joint_geometry: Its pose in that joint's frame.
        geometry: coal geometry.
        kind: "sphere", "capsule", "cylinder", "box", "ellipsoid" or "mesh".
        size: MuJoCo's size triple (half lengths and radii, m).
    """

    name: str
    body: str
    joint_id: int
    T_joint_geometry: SE3
    geometry: Any
    kind: str
    size: FloatArray


def hand_geometries(model: Any, pin_model: Any) -> tuple[LinkGeometry, ...]:
    """Every geom of the model that can collide (contype or conaffinity set).

    Raises:
        ModelError: A geom has no name, a type that a moving body cannot have, or a flat mesh.
    """
    out = []
    for g in range(model.ngeom):
        if not (model.geom_contype[g] or model.geom_conaffinity[g]):
            continue
        number = int(model.geom_bodyid[g])
        body = body_name(model, number)
        name = model.geom(g).name
        if not name:
            raise ModelError(f"a colliding geom of body {body!r} has no name; name every geom")
        kind = _TYPE.get(int(model.geom_type[g]))
        if kind is None:
            raise ModelError(
                f"geom {name!r} is a plane, a height field or a distance field; use a solid instead"
            )
        local = pose_from_wxyz(model.geom_pos[g], model.geom_quat[g])
        joint, pose = 0, local
        if number > 0:
            frame = pin_model.frames[pin_model.getBodyId(body)]
            joint, pose = int(frame.parentJoint), frame.placement * local
        out.append(
            LinkGeometry(
                name=name,
                body=body,
                joint_id=joint,
                T_joint_geometry=pose,
                geometry=coal_geometry(model, g),
                kind=kind,
                size=np.array(model.geom_size[g]),
            )
        )
    return tuple(out)


def coal_geometry(model: Any, g: int) -> Any:
    """The coal geometry of geom g, in the geom's own frame. A mesh becomes its convex hull."""
    kind = _TYPE[int(model.geom_type[g])]
    a, b, c = (float(v) for v in model.geom_size[g])
    if kind == "sphere":
        return coal.Sphere(a)
    if kind == "capsule":
        return coal.Capsule(a, 2 * b)
    if kind == "cylinder":
        return coal.Cylinder(a, 2 * b)
    if kind == "box":
        return coal.Box(2 * a, 2 * b, 2 * c)
    if kind == "ellipsoid":
        return coal.Ellipsoid(a, b, c)
    mesh = int(model.geom_dataid[g])
    start, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    return _convex_hull(model.mesh_vert[start : start + count], model.geom(g).name)


def _convex_hull(vertices: FloatArray, name: str) -> Any:
    """The convex hull of points as a coal geometry.

    Raises:
        ModelError: The points lie in a plane.
    """
    from scipy.spatial import ConvexHull, QhullError  # here, since SciPy loads slowly

    try:
        hull = ConvexHull(vertices)  # coal crashes where this raises
    except QhullError as error:
        raise ModelError(
            f"the mesh of geom {name!r} is flat, so that it has no convex hull; give it a "
            f"thickness, or write drop_collision = [{name!r}] under [repair]"
        ) from error
    return convex_geometry(np.asarray(vertices[hull.vertices], dtype=np.float64))


def allowed_pairs(model: Any, extra: Iterable[tuple[str, str]]) -> frozenset[frozenset[str]]:
    """Pairs of geoms that may touch: same body, parent and child, ``<exclude>``, and ``extra``."""
    excluded = {
        frozenset((int(s) >> 16, int(s) & 0xFFFF))
        for s in model.exclude_signature[: model.nexclude]
    }
    weld = model.body_weldid
    out = {frozenset(pair) for pair in extra}
    for g in range(model.ngeom):
        for h in range(g + 1, model.ngeom):
            bodies = int(model.geom_bodyid[g]), int(model.geom_bodyid[h])
            a, b = (int(weld[i]) for i in bodies)
            related = a == b or _weld_parent(model, a) == b or _weld_parent(model, b) == a
            if related or frozenset(bodies) in excluded:
                out.add(frozenset((model.geom(g).name, model.geom(h).name)))
    return frozenset(out)


def _weld_parent(model: Any, body: int) -> int:
    return int(model.body_weldid[model.body_parentid[body]])
