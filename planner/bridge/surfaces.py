"""Every geom of a compiled MuJoCo model as triangles on Pinocchio joints, to be looked at."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from planner.bridge.pinocchio_model import body_name
from planner.spatial import SE3, FloatArray, IntArray, pose_from_wxyz

_SPHERE, _CAPSULE, _CYLINDER, _BOX, _ELLIPSOID, _MESH = (
    int(t)
    for t in (
        mujoco.mjtGeom.mjGEOM_SPHERE,
        mujoco.mjtGeom.mjGEOM_CAPSULE,
        mujoco.mjtGeom.mjGEOM_CYLINDER,
        mujoco.mjtGeom.mjGEOM_BOX,
        mujoco.mjtGeom.mjGEOM_ELLIPSOID,
        mujoco.mjtGeom.mjGEOM_MESH,
    )
)

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
        number = int(model.geom_bodyid[g])
        body = body_name(model, number)
        joint, pose = 0, pose_from_wxyz(model.geom_pos[g], model.geom_quat[g])
        if number > 0:
            frame = pin_model.frames[pin_model.getBodyId(body)]
            joint, pose = int(frame.parentJoint), frame.placement * pose
        out.append(
            LinkSurface(
                name=model.geom(g).name or body,
                body=body,
                joint_id=joint,
                collides=bool(model.geom_contype[g] or model.geom_conaffinity[g]),
                is_mesh=int(model.geom_type[g]) == _MESH,
                vertices=_moved(pose, triangles[0]),
                triangles=triangles[1],
                colour=_colour(model, g),
            )
        )
    return tuple(out)


def _moved(pose: SE3, points: FloatArray) -> FloatArray:
    moved: FloatArray = points @ pose.rotation.T + pose.translation
    return moved


def _colour(model: Any, g: int) -> tuple[float, float, float, float]:
    material = int(model.geom_matid[g])
    rgba = model.geom_rgba[g] if material < 0 else model.mat_rgba[material]
    red, green, blue, opacity = (float(v) for v in rgba)
    return red, green, blue, opacity


def _triangles(model: Any, g: int) -> tuple[FloatArray, IntArray] | None:
    """Vertices and triangles of geom g in its own frame; None for planes and fields."""
    import trimesh  # here, since trimesh loads slowly

    kind = int(model.geom_type[g])
    a, b, c = (float(v) for v in model.geom_size[g])
    if kind == _MESH:
        mesh = int(model.geom_dataid[g])
        v, n = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
        f, m = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
        vertices = np.array(model.mesh_vert[v : v + n], dtype=np.float64)
        return vertices, np.array(model.mesh_face[f : f + m], dtype=np.int64)
    if kind == _SPHERE:
        solid = trimesh.creation.icosphere(subdivisions=BALL, radius=a)
    elif kind == _ELLIPSOID:
        solid = trimesh.creation.icosphere(subdivisions=BALL)
        solid.apply_scale([a, b, c])
    elif kind == _CAPSULE:
        solid = trimesh.creation.capsule(height=2 * b, radius=a, count=[SEGMENTS, SEGMENTS])
        solid.apply_translation([0, 0, -solid.bounds.mean(axis=0)[2]])
    elif kind == _CYLINDER:
        solid = trimesh.creation.cylinder(radius=a, height=2 * b, sections=SEGMENTS)
    elif kind == _BOX:
        solid = trimesh.creation.box(extents=[2 * a, 2 * b, 2 * c])
    else:
        return None
    return np.asarray(solid.vertices, np.float64), np.asarray(solid.faces, np.int64)
