"""``change_world``: the errors of object, joints and actuators in the scene, before it is compiled.

The object is larger or smaller, heavier or lighter, off balance, more slippery or less; joints have
dry friction, and actuators give more or less than they are asked for. What the plan believes stays.

Dry friction is MuJoCo's ``frictionloss``: a torque against the motion, up to the given one. It is a
soft constraint, so a joint that sticks creeps a little under load. It is the same at rest and in
motion (no Stribeck effect). Backlash is left out: a dead band between drive and joint takes a
degree of freedom for the drive's side of each gear, with an inertia that no model of a hand tells.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np

from planner.task import GraspTask
from sim.reality.drawn import Drawn, hand_actuators
from sim.reality.errors import Reality
from sim.scene import HAND_PREFIX, OBJECT

__all__ = ["change_world", "lifted_by"]


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
    half = drawn.size * task.object.shape.half_extents
    body.ipos = np.array(body.ipos) + drawn.center * half


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
