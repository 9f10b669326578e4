"""The geoms of a compiled MuJoCo model on Pinocchio joints, and MuJoCo at one configuration.

Colliding geoms become coal geometries; every geom becomes triangles, to be looked at. At a
configuration MuJoCo gives body positions, contacts, distances and inertias.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import coal
import mujoco
import numpy as np

from planner.bridge.pinocchio_model import body_name
from planner.errors import ModelError
from planner.shapes.hulls import convex_geometry
from planner.spatial import SE3, FloatArray, IntArray, pose_from_wxyz

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

    @property
    def corners(self) -> FloatArray:
        """Corners (8, 3) of the box along its own axes around it, own frame, m."""
        self.geometry.computeLocalAABB()
        ends = self.geometry.aabb_local.min_, self.geometry.aabb_local.max_
        return np.array(np.meshgrid(*np.transpose(ends))).reshape(3, 8).T


def hand_geometries(model: Any, pin_model: Any) -> tuple[LinkGeometry, ...]:
    """Every geom of the model that can collide (contype or conaffinity set).

    Raises:
        ModelError: A geom has no name, a type that a moving body cannot have, or a flat mesh.
    """
    out = []
    for g in range(model.ngeom):
        if not (model.geom_contype[g] or model.geom_conaffinity[g]):
            continue
        body, joint, pose = _placed(model, pin_model, g)
        name = model.geom(g).name
        if not name:
            raise ModelError(f"a colliding geom of body {body!r} has no name; name every geom")
        kind = _TYPE.get(int(model.geom_type[g]))
        if kind is None:
            raise ModelError(
                f"geom {name!r} is a plane, a height field or a distance field; use a solid instead"
            )
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


def _placed(model: Any, pin_model: Any, g: int) -> tuple[str, int, SE3]:
    """Body of geom g, the Pinocchio joint that carries it (0 for the base), and its pose there."""
    number = int(model.geom_bodyid[g])
    body, pose = body_name(model, number), pose_from_wxyz(model.geom_pos[g], model.geom_quat[g])
    if number == 0:
        return body, 0, pose
    frame = pin_model.frames[pin_model.getBodyId(body)]
    return body, int(frame.parentJoint), frame.placement * pose


def mesh_triangles(model: Any, g: int) -> tuple[FloatArray, IntArray]:
    """Vertices (n, 3), m, and faces (m, 3) of the mesh of geom g, in the geom's own frame."""
    mesh = int(model.geom_dataid[g])
    v, n = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    f, m = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
    vertices = np.array(model.mesh_vert[v : v + n], dtype=np.float64)
    return vertices, np.array(model.mesh_face[f : f + m], dtype=np.int64)


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
    return _convex_hull(mesh_triangles(model, g)[0], model.geom(g).name)


def _convex_hull(vertices: FloatArray, name: str) -> Any:
    """The convex hull of points as a coal geometry.

    Raises:
        ModelError: The points lie in a plane.
    """
    from planner.system.scipy_parts import ConvexHull, QhullError  # here: SciPy loads slowly

    try:
        hull = ConvexHull(vertices)  # coal crashes where this raises
    except QhullError as error:
        raise ModelError(
            f"the mesh of geom {name!r} is flat, so that it has no convex hull; give it a "
            f"thickness, or write drop_collision = [{name!r}] under [repair]"
        ) from error
    return convex_geometry(vertices[hull.vertices])


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


SEGMENTS = 24
"""Corners of a circle: chords lie within 1 % of its radius."""

BALL = 2
"""Subdivisions of the icosahedron that stands for a ball: 320 triangles."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LinkSurface:
    """The surface of one geom.

    Attributes:
        name: Name of the geom, of its body where it has none.
        body: Name of the body that carries it.
        joint_id: Pinocchio joint it moves with (0: the base).
        collides: Whether it can collide (contype or conaffinity set).
        is_mesh: Whether it is a mesh; MuJoCo collides with its convex hull then.
        vertices: (n, 3), m, in the joint's frame.
        triangles: (k, 3), numbers of vertices, counter-clockwise from outside.
        colour: Red, green, blue, opacity, each in [0, 1].
    """

    name: str
    body: str
    joint_id: int
    collides: bool
    is_mesh: bool
    vertices: FloatArray
    triangles: IntArray
    colour: tuple[float, float, float, float]


def link_surfaces(model: Any, pin_model: Any) -> tuple[LinkSurface, ...]:
    """The surface of every geom that is a solid, in the model's order; planes are left out.

    Args:
        model: ``mujoco.MjModel``.
        pin_model: The same as ``pinocchio.Model``, by ``pinocchio_from_mujoco``.
    """
    out = []
    for g in range(model.ngeom):
        triangles = _triangles(model, g)
        if triangles is None:
            continue
        body, joint, pose = _placed(model, pin_model, g)
        out.append(
            LinkSurface(
                name=model.geom(g).name or body,
                body=body,
                joint_id=joint,
                collides=bool(model.geom_contype[g] or model.geom_conaffinity[g]),
                is_mesh=_TYPE.get(int(model.geom_type[g])) == "mesh",
                vertices=triangles[0] @ pose.rotation.T + pose.translation,
                triangles=triangles[1],
                colour=_colour(model, g),
            )
        )
    return tuple(out)


def _colour(model: Any, g: int) -> tuple[float, float, float, float]:
    material = int(model.geom_matid[g])
    rgba = model.geom_rgba[g] if material < 0 else model.mat_rgba[material]
    red, green, blue, opacity = (float(v) for v in rgba)
    return red, green, blue, opacity


def _triangles(model: Any, g: int) -> tuple[FloatArray, IntArray] | None:
    """Vertices and triangles of geom g in its own frame; None for planes and fields."""
    import trimesh  # here, since trimesh loads slowly

    kind = _TYPE.get(int(model.geom_type[g]))
    a, b, c = (float(v) for v in model.geom_size[g])
    if kind == "mesh":
        return mesh_triangles(model, g)
    if kind == "sphere":
        solid = trimesh.creation.icosphere(subdivisions=BALL, radius=a)
    elif kind == "ellipsoid":
        solid = trimesh.creation.icosphere(subdivisions=BALL)
        solid.apply_scale([a, b, c])
    elif kind == "capsule":
        solid = trimesh.creation.capsule(height=2 * b, radius=a, count=[SEGMENTS, SEGMENTS])
        solid.apply_translation([0, 0, -solid.bounds.mean(axis=0)[2]])
    elif kind == "cylinder":
        solid = trimesh.creation.cylinder(radius=a, height=2 * b, sections=SEGMENTS)
    elif kind == "box":
        solid = trimesh.creation.box(extents=[2 * a, 2 * b, 2 * c])
    else:
        return None
    return np.asarray(solid.vertices, np.float64), np.asarray(solid.faces, np.int64)


FURTHEST = 1.0
"""Largest distance (m) that MuJoCo measures between two geoms."""


def _moved_to(model: Any, q: FloatArray) -> Any:
    """A ``mujoco.MjData`` at q (nq,)."""
    data = mujoco.MjData(model)
    data.qpos[:] = q
    mujoco.mj_forward(model, data)
    return data


def joint_inertia(model: Any, q: FloatArray) -> FloatArray:
    """Diagonal (nv,) of the mass matrix at q (nv,), kg m^2 (kg): the inertia at each servo."""
    data = _moved_to(model, q)
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    return np.diag(full).copy()


def body_positions(model: Any, q: FloatArray) -> FloatArray:
    """Positions (nbody, 3) of all bodies at q (nq,) by MuJoCo's kinematics, m."""
    data = _moved_to(model, q)
    return np.array(data.xpos)


def touching_geoms(model: Any, q: FloatArray) -> tuple[tuple[str, str, float], ...]:
    """Pairs of geoms that MuJoCo finds in contact at q (nq,), with the signed distance, m."""
    data = _moved_to(model, q)
    nearest: dict[tuple[str, str], float] = {}
    for i in range(data.ncon):
        contact = data.contact[i]
        names = sorted(model.geom(int(g)).name for g in contact.geom)
        pair = (names[0], names[1])
        nearest[pair] = min(nearest.get(pair, np.inf), float(contact.dist))
    return tuple((a, b, d) for (a, b), d in nearest.items())


def geom_distance(model: Any, q: FloatArray, first: str, second: str) -> float:
    """Signed distance of two geoms at q (nq,) by MuJoCo, m; at most ``FURTHEST``."""
    data = _moved_to(model, q)
    ids = model.geom(first).id, model.geom(second).id
    return float(mujoco.mj_geomDistance(model, data, *ids, FURTHEST, None))
