"""Key frames of an exported scene: states of hand and object, and the commands that belong to them.

    pregrasp   fingers open; commands that hold the hand's own weight there
    grasp      fingers on the object; the same commands at that posture: nothing presses yet
    squeeze    the state of ``grasp``; commands that make the planned forces

The commands are those of position servos and do not depend on the state: at the planned posture
each servo's own law gives exactly the torque that the planned contact forces and the weight of
hand and object need, and elsewhere its stiffness pulls back (``sim.controllers.grasp``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planner.collision.moving_hand import moving_hand
from planner.errors import TaskError
from planner.exchange.dexgraspbench.squeeze import without_servos
from planner.plan import GraspPlan
from planner.spatial import FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class KeyFrame:
    """A state at rest and the commands of the hand's actuators.

    Attributes:
        name: "pregrasp", "grasp" or "squeeze".
        q: Joints (nq,), rad or m, order of ``hand.joint_names``.
        ctrl: Commands (nu,), order of ``hand.actuation.names``.
    """

    name: str
    q: FloatArray
    ctrl: FloatArray


def key_frames(plan: GraspPlan) -> tuple[KeyFrame, ...]:
    """The key frames of a plan.

    Raises:
        TaskError: The hand has actuators that follow no position, or the plan has no forces.
    """
    hand = plan.task.hand
    if reason := without_servos(hand):
        raise TaskError(
            f"{reason}; an exported scene is held by position commands: plan with a hand that has "
            "position servos"
        )
    if not plan.forces.found:
        raise TaskError(
            f"the plan has no contact forces: {plan.forces.reason}; plan again with a smaller grip"
        )
    gravity = plan.T_world_base.rotation.T @ plan.task.gravity

    def resting(q: FloatArray) -> FloatArray:
        weight = moving_hand(hand).move(q).gravity_torque(gravity)
        return hand.actuation.commands(q, np.zeros(hand.nq), np.asarray(weight))

    q, opened = np.array(plan.q), np.array(plan.q_pregrasp)
    pressing = hand.actuation.commands(q, np.zeros(hand.nq), np.array(plan.forces.joint_torques))
    return (
        KeyFrame(name="pregrasp", q=opened, ctrl=resting(opened)),
        KeyFrame(name="grasp", q=q, ctrl=resting(q)),
        KeyFrame(name="squeeze", q=q, ctrl=pressing),
    )
