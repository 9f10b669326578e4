"""``MotorServo``: what a torque motor needs to follow a posture: spring, damper, its joint's drag.

    torque = K (q* - q) + D (v* - v) + b v* + c clip(v* / FULL_FRICTION_RATE, -1, 1)

with v* the rate of the wanted posture q*, and b, c the joint's own damping and dry friction, which
a light finger would else lag behind by a tenth of a second. Joints whose actuators are servos have
that already, and get nothing.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from planner.hands.hand import Hand
from planner.spatial import FloatArray

MOTOR_FREQUENCY, MOTOR_DAMPING = 30.0, 1.0
"""Natural frequency (rad/s) and damping ratio (-) of the spring given to joints with motors: about
the stiffness of a hand with servos."""

STICTION_ERROR = 0.005
"""Largest deflection (rad) of that spring by the joint's dry friction: half a millimetre at the end
of a finger of 10 cm. Light links would else stick short of the object."""

FULL_FRICTION_RATE = 0.05
"""Wanted rate (rad/s) of a joint from which on all of its dry friction is made up for."""


class MotorServo:
    """Follows a posture with the joints that have motors, and those that are tied to them."""

    def __init__(self, hand: Hand, q: FloatArray) -> None:
        """Prepare gains for a hand about a posture q (nq,)."""
        self._stiffness, self._damping = motor_servo(hand, q)
        mine = _with_motors(hand)
        for coupling in hand.couplings:
            if (coupling.row[mine] != 0).any():
                mine |= (coupling.row != 0) & ~_with_servos(hand)
        self._drag, self._stiction = (part * mine for part in joint_drag(hand))
        self._goal: FloatArray | None = None
        self._time = 0.0
        gains = self._stiffness, self._damping, self._drag, self._stiction
        self._acts = any(gain.any() for gain in gains)

    def rest(self) -> None:
        """The next posture may be anywhere: it is not moved to, it is where the hand is."""
        self._goal = None

    def torque(self, time: float, goal: FloatArray, q: FloatArray, v: FloatArray) -> FloatArray:
        """Joint torques (nq,), N m, beside those that hold the hand's weight.

        Args:
            time: Now, s.
            goal: Where the joints (nq,) should be now, rad.
            q: Where they are (nq,), rad.
            v: Their rates (nq,), rad/s.
        """
        if not self._acts:
            return np.zeros(len(goal))
        elapsed, self._time = time - self._time, time
        rate = np.zeros(len(goal))
        if self._goal is not None and elapsed > 0:
            rate = (goal - self._goal) / elapsed
        self._goal = goal.copy()
        sign = np.minimum(np.maximum(rate / FULL_FRICTION_RATE, -1.0), 1.0)
        drag = self._drag * rate + self._stiction * sign
        return np.asarray(self._stiffness * (goal - q) + self._damping * (rate - v) + drag)


def motor_servo(hand: Hand, q: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Stiffness and damping (nq,) for joints that are driven but have no servo of their own."""
    inertia = np.diag(pin.crba(hand.pin_model, hand.pin_model.createData(), q))
    _, stiction = joint_drag(hand)
    stiffness = np.maximum(inertia * MOTOR_FREQUENCY**2, stiction / STICTION_ERROR)
    mine = _with_motors(hand)
    return stiffness * mine, 2.0 * MOTOR_DAMPING * np.sqrt(stiffness * inertia) * mine


def joint_drag(hand: Hand) -> tuple[FloatArray, FloatArray]:
    """Damping (nq,), N m s/rad, and dry friction (nq,), N m, of a hand's joints by its model."""
    model = hand.pin_model
    return np.array(model.damping), np.array(model.upperDryFrictionLimit)


def _with_motors(hand: Hand) -> NDArray[np.bool_]:
    return np.asarray((hand.actuation.moment != 0).any(axis=0) & ~_with_servos(hand))


def _with_servos(hand: Hand) -> NDArray[np.bool_]:
    actuation = hand.actuation
    return np.asarray((-actuation.bias[:, 1] @ actuation.moment**2) > 0)
