"""``change_world``: the errors of object, joints and actuators in the scene, before it is compiled.

The object is larger or smaller, heavier or lighter, off balance, more slippery or less; joints have
dry friction, and actuators give more or less than they are asked for. What the plan believes stays.

Dry friction is MuJoCo's ``frictionloss``: a torque against the motion, up to the given one. It is a
soft constraint, so a joint that sticks creeps a little under load. It is the same at rest and in
motion (no Stribeck effect).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np

from planner.spatial import FloatArray
from planner.task import GraspTask
from sim.reality.drawn import Drawn, hand_actuators
from sim.reality.errors import Reality
from sim.scene import HAND_PREFIX, OBJECT

SIDES, TILT, WITHIN = 32, 0.01, 0.9
"""Directions (-) in which what an object stands on is measured, the tilt (rad) at which its extent
is read off the support function, and the share (-) of it that the centre of mass stays within."""


def change_world(reality: Reality, drawn: Drawn, task: GraspTask) -> Callable[[Any], None]:
    """What changes the ``mujoco.MjSpec`` of a task's scene to what there really is.

    Args:
        reality: Its errors.
        drawn: What was drawn of them.
        task: As it is believed.
    """

    def change(spec: Any) -> None:
        _change_object(spec, drawn, task)
        _change_hand(spec, reality.dry_friction, drawn, task)

    return change


def lifted_by(drawn: Drawn, task: GraspTask) -> float:
    """How much higher (m) the object's frame stands for its true size; 0 if nothing carries it."""
    if task.table_height is None:
        return 0.0
    down = -task.T_world_object.rotation[2]
    return (drawn.size - 1.0) * task.object.shape.support(down)


def center_offset(drawn: Drawn, task: GraspTask) -> FloatArray:
    """How far (3,), m, object's axes, the true centre of mass is from the believed one.

    An object on a table is known to stand there at rest. So its centre of mass stays above what it
    stands on: sideways that of a box may be off, that of a ball is not, or it would roll away.
    """
    shape = task.object.shape
    offset = np.asarray(drawn.center * drawn.size * shape.half_extents)
    if task.table_height is None:
        return offset
    R = task.T_world_object.rotation
    there = R @ offset
    down, most = np.array([0.0, 0.0, -1.0]), 1.0
    for angle in np.linspace(0.0, 2.0 * np.pi, SIDES, endpoint=False):
        side = np.array([np.cos(angle), np.sin(angle), 0.0])
        tilted = np.cos(TILT) * down + np.sin(TILT) * side
        beyond = shape.support(R.T @ tilted) - np.cos(TILT) * shape.support(R.T @ down)
        extent = drawn.size * beyond / np.sin(TILT)
        aside = float(there @ side)
        if aside > WITHIN * extent:
            most = min(most, WITHIN * extent / aside)
    there[:2] *= most
    return np.asarray(R.T @ there)


def _change_object(spec: Any, drawn: Drawn, task: GraspTask) -> None:
    body = spec.body(OBJECT)
    for geom in body.geoms:
        geom.friction = drawn.friction * np.array(geom.friction)
        geom.pos = drawn.size * np.array(geom.pos)
        if geom.type == mujoco.mjtGeom.mjGEOM_MESH:
            mesh = spec.mesh(geom.meshname)
            mesh.uservert = drawn.size * np.array(mesh.uservert)
        else:
            geom.size = drawn.size * np.array(geom.size)
    body.mass *= drawn.mass
    body.fullinertia = drawn.mass * drawn.size**2 * np.array(body.fullinertia)
    body.ipos = np.array(body.ipos) + center_offset(drawn, task)


def _change_hand(spec: Any, dry_friction: float, drawn: Drawn, task: GraspTask) -> None:
    hand = task.hand
    of_arm = set(hand.arm_index.tolist())
    for k, name in enumerate(hand.joint_names):
        if k not in of_arm:
            spec.joint(HAND_PREFIX + name).frictionloss += dry_friction
    for k in np.flatnonzero(hand_actuators(hand)).tolist():
        actuator = spec.actuator(HAND_PREFIX + hand.actuation.names[k])
        actuator.ctrllimited = int(mujoco.mjtLimited.mjLIMITED_FALSE)  # the drive clips
        factor = 1.0 + float(drawn.torque_constant[k])
        actuator.gainprm = factor * np.array(actuator.gainprm)
        actuator.biasprm = factor * np.array(actuator.biasprm)
        actuator.forcerange = factor * np.array(actuator.forcerange)
