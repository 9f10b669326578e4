"""How a hand of primitives looks: rounded housings, a palm in one piece, knuckles on its joints.

What is added has no mass and does not collide. What it stands for goes to a group of geoms that is
not drawn (3 in MuJoCo's viewer) and collides as before; pads and links are drawn as they collide.
A hand that has geoms to be seen only, as published models have, is drawn as it is; but of its sky
and its lights a scene has its own.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from typing import Any

import mujoco
import numpy as np

from planner.bridge.load import HIDDEN_GROUP
from planner.spatial import FloatArray

__all__ = ["HIDDEN_GROUP", "dress_hand"]

_TYPE = mujoco.mjtGeom
BOX, CYLINDER = int(_TYPE.mjGEOM_BOX), int(_TYPE.mjGEOM_CYLINDER)
CAPSULE = int(_TYPE.mjGEOM_CAPSULE)
PRIMITIVES = {BOX, CYLINDER, CAPSULE, int(_TYPE.mjGEOM_SPHERE), int(_TYPE.mjGEOM_ELLIPSOID)}
HINGE = int(mujoco.mjtJoint.mjJNT_HINGE)

ROUNDING, LARGEST_ROUNDING = 0.42, 0.008
"""Radius of a housing's edges: a share of its least half extent, and at most so many m."""

BOOT_PROUD, PIN_PROUD = 0.0006, 0.0012
"""How far (m) the boot and the pin of a knuckle stand out of its link."""

PIN_SHARE = 0.5
"""Radius of the pin over that of the link."""

BOOT_RGBA, PIN_RGBA = (0.17, 0.18, 0.20, 1.0), (0.55, 0.57, 0.60, 1.0)

LONGEST_KNUCKLE = 0.03
"""Radius (m) of links above which joints get no knuckle: arms and forearms have their own look."""

RIM = 32
"""Points around an edge of a mesh."""


def dress_hand(spec: Any, model: Any) -> None:
    """Add what is seen to a spec of a hand, in place; take its own sky and lights away.

    Args:
        spec: ``mujoco.MjSpec`` with named geoms.
        model: The same, compiled: ``mujoco.MjModel``.
    """
    skies = [t for t in spec.textures if t.type == mujoco.mjtTexture.mjTEXTURE_SKYBOX]
    for element in (*skies, *spec.lights):
        spec.delete(element)
    if spec.compiler.discardvisual or not _plain(model):
        return
    housings: dict[int, list[int]] = defaultdict(list)
    for g in range(model.ngeom):
        kind, body = int(model.geom_type[g]), int(model.geom_bodyid[g])
        if kind == BOX:
            housings[body].append(g)
        elif kind == CYLINDER:
            _replace(spec, model, [g], _rims(model, g))
    for geoms in housings.values():
        balls = [ball for g in geoms for ball in _corner_balls(model, g)]
        _replace(spec, model, geoms, np.concatenate(balls))
    for joint in range(model.njnt):
        _add_knuckle(spec, model, joint)


def _plain(model: Any) -> bool:
    """Whether all geoms are named primitives that collide."""
    collides = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    named = all(model.geom(g).name for g in range(model.ngeom))
    return bool(model.ngeom and collides.all() and named and set(model.geom_type) <= PRIMITIVES)


def _replace(spec: Any, model: Any, geoms: Sequence[int], points: FloatArray) -> None:
    """Show the convex hull of points (n, 3), in the body's frame, instead of geoms of a body."""
    first = spec.geom(model.geom(geoms[0]).name)
    name = f"{first.name}/seen"
    mesh = spec.add_mesh(name=name)
    mesh.uservert = points.ravel()
    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
    seen = first.parent.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name)
    seen.material, seen.rgba = first.material, first.rgba
    _only_seen(seen)
    for g in geoms:
        spec.geom(model.geom(g).name).group = HIDDEN_GROUP


def _only_seen(geom: Any) -> None:
    geom.contype = geom.conaffinity = 0
    geom.mass = geom.density = 0.0
    geom.group = 0


def _corner_balls(model: Any, g: int) -> Iterable[FloatArray]:
    """Balls (n, 3) in the corners of a box, whose hull is the box with rounded edges."""
    half = model.geom_size[g]
    radius = min(ROUNDING * float(half.min()), LARGEST_ROUNDING)
    ball = radius * _ball()
    for signs in np.ndindex(2, 2, 2):
        yield _in_body(model, g, (2 * np.array(signs) - 1) * (half - radius) + ball)


def _rims(model: Any, g: int) -> FloatArray:
    """Points (n, 3) of a cylinder with rounded edges."""
    radius, half, _ = model.geom_size[g]
    rounding = min(ROUNDING * min(radius, half), LARGEST_ROUNDING)
    around = np.linspace(0.0, 2 * np.pi, 2 * RIM, endpoint=False)
    rows = []
    for angle in np.linspace(0.0, np.pi / 2, 5):
        r = radius - rounding * (1 - np.cos(angle))
        z = half - rounding * (1 - np.sin(angle))
        for side in (-z, z):
            ring = [r * np.cos(around), r * np.sin(around), np.full_like(around, side)]
            rows.append(np.column_stack(ring))
    return _in_body(model, g, np.concatenate(rows))


def _in_body(model: Any, g: int, points: FloatArray) -> FloatArray:
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, model.geom_quat[g])
    return np.asarray(points @ turn.reshape(3, 3).T + model.geom_pos[g])


def _ball() -> FloatArray:
    """Points (n, 3) of the unit sphere, on circles of latitude."""
    around = np.linspace(0.0, 2 * np.pi, RIM // 2, endpoint=False)
    rows = [np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])]
    for up in np.linspace(-np.pi / 2, np.pi / 2, 7)[1:-1]:
        flat = np.cos(up)
        ring = [flat * np.cos(around), flat * np.sin(around), np.full_like(around, np.sin(up))]
        rows.append(np.column_stack(ring))
    return np.concatenate(rows)


def _add_knuckle(spec: Any, model: Any, joint: int) -> None:
    """A boot around the joint, and a pin through it along the axis, where a hinge bends a link."""
    body, position = int(model.jnt_bodyid[joint]), model.jnt_pos[joint]
    first = int(model.body_geomadr[body])
    links = [
        g
        for g in range(first, first + int(model.body_geomnum[body]))
        if int(model.geom_type[g]) == CAPSULE
    ]
    if int(model.jnt_type[joint]) != HINGE or not links:
        return
    link = links[0]
    radius = float(model.geom_size[link][0])
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, model.geom_quat[link])
    bone, axis = turn.reshape(3, 3)[:, 2], model.jnt_axis[joint]
    off = position - model.geom_pos[link]
    along = abs(float(off @ bone)) - float(model.geom_size[link][1])
    aside = float(np.linalg.norm(off - (off @ bone) * bone))
    if abs(bone @ axis) > 0.5 or radius > LONGEST_KNUCKLE or abs(along) > radius or aside > radius:
        return
    owner, name = spec.body(model.body(body).name), model.joint(joint).name
    boot = owner.add_geom(
        name=f"{name}/boot",
        type=mujoco.mjtGeom.mjGEOM_SPHERE,
        size=(radius + BOOT_PROUD, 0.0, 0.0),
        pos=position,
        rgba=BOOT_RGBA,
    )
    half = radius + PIN_PROUD
    pin = owner.add_geom(
        name=f"{name}/pin",
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        size=(PIN_SHARE * radius, 0.0, 0.0),
        fromto=[*(position - half * axis), *(position + half * axis)],
        rgba=PIN_RGBA,
    )
    _only_seen(boot)
    _only_seen(pin)
