"""``PostureServo``: moves the fingers to a posture, and holds the hand's own weight."""

from __future__ import annotations

import numpy as np

from planner.kinematics.state import MovingHand
from planner.plan import GraspPlan
from planner.spatial import FloatArray, minimum_jerk
from sim.controllers.base import Observation
from sim.controllers.motors import MotorServo

__all__ = ["PostureServo"]


class PostureServo:
    """Goes to a posture evenly in all joints; motors by a ``MotorServo``."""

    def __init__(self, plan: GraspPlan, goal: FloatArray) -> None:
        """Prepare gains.

        Args:
            plan: Whose hand it is.
            goal: Posture (nq,); the fingers that take part go there, other joints stay.
        """
        task = plan.task
        self._hand, self._gravity = task.hand, task.gravity
        self._goal = goal
        self._index = np.concatenate([f.q_index for f in task.fingers])
        self._servo = MotorServo(task.hand, plan.q)
        self._state = MovingHand(task.hand, plan.q)
        self._begin: FloatArray | None = None

    def command(self, observation: Observation, share: float) -> FloatArray:
        """Commands (nu,) for a share of the way, in [0, 1]."""
        if self._begin is None:
            self._begin = observation.q.copy()
        q = self._begin.copy()
        way = float(minimum_jerk(np.asarray(share)))
        q[self._index] += way * (self._goal - self._begin)[self._index]
        gravity = observation.T_world_base.rotation.T @ self._gravity
        torque = self._state.move(observation.q).gravity_torque(gravity)
        torque += self._servo.torque(observation.time, q, observation.q, observation.v)
        ctrl, _ = self._hand.actuation.ctrl_for_torque(q, np.zeros(self._hand.nq), torque)
        return ctrl
