"""``FoundFriction``: dry friction of finger joints beyond the hand's model, felt on their way.

Called by ``GraspController`` at every step before the squeeze. A finger that moves freely takes the
torque of its weight and of its joints' drag; what its actuators give beyond that along the motion
overcomes dry friction. ``ObjectImpedance`` makes up for it while the fingers turn an object: else
a joint of 0.02 N m holds the tip 5 cm away back by 0.4 N, and the force programme, which cannot see
that, spends friction cones and normal forces on it until no forces are left.
"""

from __future__ import annotations

import numpy as np

from planner.hands.hand import Hand
from planner.spatial import FloatArray
from sim.controllers.motors import FULL_FRICTION_RATE, joint_drag

FAST = 0.3
"""Rate (rad/s) of an actuator's length from which on a step counts: six times that at which all of
a joint's dry friction acts."""

LEAST_TIME = 0.05
"""Time (s) that an actuator must have moved fast for its mean to count."""

LEAST_FRICTION = 0.005
"""Dry friction (N m) below which nothing is made up for: acceleration and damping leave up to 0.002
where there is none (eight closings of two hands); 0.02 beyond the model's are found as 0.020."""


class FoundFriction:
    """The dry friction of one hand's finger joints, as far as it is known."""

    def __init__(self, hand: Hand) -> None:
        """Nothing is known yet."""
        self._actuation = a = hand.actuation
        self._fingers = np.zeros(hand.nq, dtype=bool)
        for finger in hand.fingers.values():
            self._fingers[finger.q_index] = True
        drives = a.moment != 0
        self._counts = drives.any(axis=1) & ~(drives & ~self._fingers).any(axis=1)
        self._drag, self._stiction = joint_drag(hand)
        self._sum, self._size, self._time = np.zeros((3, len(a.names)))

    def feel(
        self, elapsed: float, ctrl: FloatArray, q: FloatArray, v: FloatArray, weight: FloatArray
    ) -> None:
        """Take over a step in which nothing touches.

        Args:
            elapsed: Since the last step, s.
            ctrl: Commands (nu,) that were given at these joints.
            q: Joints as the servos' encoders have them (nq,).
            v: Their rates (nq,).
            weight: Joint torques (nq,) that hold the hand's weight, N m.
        """
        a = self._actuation
        rate = a.moment @ v
        fast = self._counts & (np.abs(rate) > FAST)
        if not fast.any():
            return
        law = a.bias[:, 0] + a.bias[:, 1] * (a.moment @ q + a.length0) + a.bias[:, 2] * rate
        push = np.clip(a.gain * ctrl + law, *a.force_range.T)
        sign = np.clip(v / FULL_FRICTION_RATE, -1.0, 1.0)
        # of a tendon's two joints often one moves
        size = np.sign(rate) * (a.moment @ sign)
        fast &= size > 0.0
        free, _ = a.split_torque(q, weight + self._drag * v + self._stiction * sign)
        self._sum += np.where(fast, elapsed * np.sign(rate) * (push - free), 0.0)
        self._size += np.where(fast, elapsed * size, 0.0)
        self._time += np.where(fast, elapsed, 0.0)

    @property
    def extra(self) -> FloatArray:
        """Dry friction (nq,) of the fingers' joints beyond the model's, N m; 0 if it has none.

        One number for all, the median over the actuators that moved: many joints hardly move while
        a hand closes, and those of a hand are built alike.
        """
        moved = self._time >= LEAST_TIME
        if not moved.any():
            return np.zeros(len(self._fingers))
        each = self._sum[moved] / self._size[moved]
        found = float(np.median(each))
        return np.where(self._fingers, found if found > LEAST_FRICTION else 0.0, 0.0)
