"""``FingerSwing``: moves a finger that is off the object along its planned way until it lands.

Its actuators follow the way by servos instead of the contact forces. The way is that of a
``Relocation``, from the measured posture at the start. Beyond its end the pad moves on slowly along
the normal until it feels the object.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from planner.kinematics.state import MovingHand
from planner.motion.gait import Relocation
from planner.plan import GraspPlan
from planner.spatial import FloatArray, minimum_jerk
from sim.controllers import Observation
from sim.controllers.closing import SEARCH_DAMPING
from sim.controllers.hand_dynamics import motor_servo

LANDING_SPEED = 0.02
"""Speed (m/s) along the normal of a pad that has come to the end of its way without touching."""

DEEPEST = 0.008
"""How far (m) it goes: more than object and hand are beside their places."""

RATE_STEP = 1e-3
"""Share of the time (-) over which a rate is taken."""

PEAK = 1.875
"""Largest rate of a minimum-jerk profile beside its mean (-)."""

SHORTEST = 1e-3
"""Change of joints (rad) that a piece of the way counts at least."""

QUICKEST = 0.15
"""Least time (s) for a way: what a servo of a finger follows."""


class FingerSwing:
    """Moves one finger; starts at the first command.

    Attributes:
        finger: Its name.
        duration: Time for its way, s.
        share: How much of that has passed, in [0, 1].
        actuators: (nu,), which are the finger's.
    """

    def __init__(self, plan: GraspPlan, relocation: Relocation, rate: float) -> None:
        """Prepare the way.

        Args:
            plan: Whose hand it is.
            relocation: The way.
            rate: Largest rate of its joints, rad/s; they go evenly along the way.
        """
        task = plan.task
        hand, finger = task.hand, task.hand.fingers[relocation.finger]
        self.finger = relocation.finger
        self._hand, self._gravity = hand, task.gravity
        self._index = finger.q_index
        self.actuators: NDArray[np.bool_] = (hand.actuation.moment[:, self._index] != 0).any(axis=1)
        way = relocation.postures[:, self._index]
        pieces = np.maximum(np.abs(np.diff(way, axis=0)).max(axis=1), SHORTEST)
        gone = np.concatenate([[0.0], np.cumsum(pieces)])
        self._way = PchipInterpolator(gone / gone[-1], way)
        self._middle = float(gone[len(way) // 2] / gone[-1])
        self.duration = max(QUICKEST, PEAK * float(gone[-1]) / rate)
        self._state = MovingHand(hand, relocation.postures[-1])
        self._stiffness, self._damping = motor_servo(hand, plan.q)
        landing = relocation.landing
        T_base_world = plan.T_world_base.inverse()
        jac = self._state.point_jacobian(finger.pad.joint_id, T_base_world.act(landing.position))
        jac = jac[:3, self._index]
        gram = jac @ jac.T + SEARCH_DAMPING**2 * np.eye(3)
        self._inwards = jac.T @ np.linalg.solve(gram, T_base_world.rotation @ landing.frame[:, 0])
        self._bent: FloatArray | None = None
        self._time = 0.0
        self._reach = 0.0
        self.share = 0.0

    @property
    def over(self) -> bool:
        """Whether it is half-way at least: lifted, and near where it goes down."""
        return float(minimum_jerk(np.asarray(self.share))) >= self._middle

    def command(self, observation: Observation) -> FloatArray:
        """Commands (nu,) of which the finger's count."""
        k = self._index
        if self._bent is None:
            self._bent, self._time = observation.q[k] - self._way(0.0), observation.time
        elapsed, self._time = observation.time - self._time, observation.time
        if self.share < 1.0:
            self.share = min(1.0, self.share + elapsed / self.duration)
        else:
            self._reach = min(DEEPEST, self._reach + LANDING_SPEED * elapsed)
        here, there = (self._at(s, self._bent) for s in (self.share, self.share + RATE_STEP))
        q, v = observation.q.copy(), np.zeros(self._hand.nq)
        q[k] = here + self._reach * self._inwards
        v[k] = (there - here) / (RATE_STEP * self.duration)
        gravity = observation.T_world_base.rotation.T @ self._gravity
        torque = self._state.move(observation.q).gravity_torque(gravity)
        torque += self._hand.pin_model.damping * v
        torque += self._stiffness * (q - observation.q) + self._damping * (v - observation.v)
        ctrl = self._hand.actuation.commands(q, v, torque)
        return ctrl

    def _at(self, share: float, bent: FloatArray) -> FloatArray:
        """Joints (k,) at a share of the time, with what is left there of a difference (k,)."""
        s = float(minimum_jerk(np.asarray(min(1.0, share))))
        return np.asarray(self._way(s) + (1.0 - s) * bent)
