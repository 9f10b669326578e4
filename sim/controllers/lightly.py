"""``LightTouch``: limits what actuators do beyond moving the hand, while nothing is to be pressed.

Called by ``GraspController`` before the squeeze. A free finger needs the torque of its weight and
of its joints' drag. What a servo does beyond that pushes on something: an object that was not
expected yet, a table that a finger with joints that are off is led into. Up to ``LIGHTEST`` it is
let, then the finger gives way. A free hand moves as without it.
"""

from __future__ import annotations

import numpy as np

from planner.hands.hand import Hand
from planner.spatial import FloatArray
from sim.controllers.motors import FULL_FRICTION_RATE, joint_drag

LIGHTEST = 0.05
"""Torque (N m) that a finger's actuator may push with: 0.5 N at a tip 0.1 m from its joint, half of
what counts as a collision (``sim.verdict.COLLISION_N``)."""


class LightTouch:
    """The limit for one hand."""

    def __init__(self, hand: Hand) -> None:
        """Find the actuators that drive only joints of fingers; wrist and arm are left alone."""
        self._actuation = a = hand.actuation
        of_fingers = np.zeros(hand.nq, dtype=bool)
        for finger in hand.fingers.values():
            of_fingers[finger.q_index] = True
        drives = a.moment != 0
        self._limited = drives.any(axis=1) & ~(drives & ~of_fingers).any(axis=1)
        size = np.abs(a.moment).max(axis=1, initial=0.0)
        self._most = np.where(self._limited, LIGHTEST / np.where(size > 0, size, 1.0), np.inf)
        self._drag, self._stiction = joint_drag(hand)

    def commands(
        self, ctrl: FloatArray, q: FloatArray, v: FloatArray, weight: FloatArray
    ) -> FloatArray:
        """The commands (nu,) with no actuator pushing harder than lightly.

        Args:
            ctrl: Commands (nu,).
            q: Joints as read (nq,).
            v: Their rates (nq,).
            weight: Joint torques (nq,) that hold the hand's weight, N m.
        """
        a = self._actuation
        law = (
            a.bias[:, 0] + a.bias[:, 1] * (a.moment @ q + a.length0) + a.bias[:, 2] * (a.moment @ v)
        )
        push = a.gain * ctrl + law
        sign = np.clip(v / FULL_FRICTION_RATE, -1.0, 1.0)
        free, _ = a.split_torque(q, weight + self._drag * v + self._stiction * sign)
        beyond = push - free
        if (np.abs(beyond) <= self._most).all():
            return ctrl
        return np.asarray((free + np.clip(beyond, -self._most, self._most) - law) / a.gain)
