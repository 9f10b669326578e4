"""Torques of the hand itself: its weight, its joints' drag, and what its actuators do beyond.

``HandLoads``: Jacobians of a moving hand and the torque of its weight, by one call per step.
Pinocchio computes the joints' Jacobian on the way to that of the centre of mass; ``MovingHand``
computes it a second time. Contact forces become torques in one product for all fingers.

``MotorServo``: what a torque motor needs to follow a posture: spring, damper, its joint's drag.

    torque = K (q* - q) + D (v* - v) + b v* + c clip(v* / FULL_FRICTION_RATE, -1, 1)

with v* the rate of the wanted posture q*, and b, c the joint's own damping and dry friction, which
a light finger would else lag behind by a tenth of a second. Joints whose actuators are servos have
that already, and get nothing.

A free finger needs the torque of its weight and of its joints' drag (``FreeFingers``). Called by
``GraspController`` before the squeeze, two classes look at what actuators do beyond that:

``ContactForceLimit``: what a servo does beyond it pushes on something, an object that was not
expected yet, or a table that a finger is led into whose joints are off. Up to ``CONTACT_TORQUE`` it
is let, then the finger gives way. A free hand moves as without it.

``FrictionEstimate``: what actuators give beyond it along the motion overcomes dry friction that the
hand's model has not. ``ObjectImpedance`` compensates it while the fingers turn an object: else a
joint of 0.02 N m holds the tip 5 cm away back by 0.4 N, and the force programme, which cannot see
that, spends friction cones and normal forces on it until no forces are left.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from pinocchio import SE3

from planner.hands.fingers import Finger
from planner.hands.hand import Hand
from planner.spatial import FloatArray


class HandLoads:
    """A hand that moves from one posture to the next, seen by forces at some fingers' pads.

    Attributes:
        jacobian: (6, nq), twist of the point at the base's origin per joint rate, if every joint
            moved the pad.
        moved_by: (n, nq), which joints move the pad of each finger.
    """

    def __init__(self, hand: Hand, fingers: Sequence[Finger]) -> None:
        """Prepare memory; call ``move`` next."""
        self._model, self._data = hand.pin_model, hand.pin_model.createData()
        self._palm = hand.palm_frame_id
        self.jacobian: FloatArray = np.zeros((6, hand.nq))
        self.moved_by = np.array(hand.moved_by[[finger.pad.joint_id for finger in fingers]])

    def move(self, q: FloatArray, gravity: FloatArray) -> FloatArray:
        """Go to joints q (nq,); returns the torques (nq,), N m, that hold the hand's weight.

        Args:
            q: Joints, rad or m.
            gravity: (3,), m/s2, base axes.
        """
        of_mass_centre = pin.jacobianCenterOfMass(self._model, self._data, q)
        self.jacobian[:] = self._data.J
        return np.array(-float(self._data.mass[0]) * of_mass_centre.T @ gravity)

    @property
    def T_base_palm(self) -> SE3:
        """Pose of the palm's body in the base."""
        return SE3(pin.updateFramePlacement(self._model, self._data, self._palm))

    def pose(self, joint_id: int) -> SE3:
        """Pose of a joint's frame in the base."""
        return SE3(self._data.oMi[joint_id])

    def at(self, joint_id: int, point: FloatArray) -> FloatArray:
        """A point (3,) of a joint's frame in the base, m."""
        placed: FloatArray = self._data.oMi[joint_id].act(point)
        return placed

    def torque(self, forces: FloatArray, moments: FloatArray) -> FloatArray:
        """Joint torques (nq,), N m, that exert forces at the pads.

        Args:
            forces: (n, 3), on the object, base axes, N.
            moments: (n, 3), about the base's origin, N m.
        """
        both = np.array([forces, moments])[:, :, None]  # (2, n, 1, 3)
        of_forces, of_moments = (both @ self.jacobian.reshape(2, 1, 3, -1))[:, :, 0]
        out: FloatArray = np.where(self.moved_by, of_forces + of_moments, 0.0).sum(axis=0)
        return out


MOTOR_FREQUENCY, MOTOR_DAMPING = 30.0, 1.0
"""Natural frequency (rad/s) and damping ratio (-) of the spring given to joints with motors: about
the stiffness of a hand with servos."""

STICTION_ERROR = 0.005
"""Largest deflection (rad) of that spring by the joint's dry friction: half a millimetre at the end
of a finger of 10 cm. Light links would else stick short of the object."""

FULL_FRICTION_RATE = 0.05
"""Wanted rate (rad/s) of a joint from which on all of its dry friction is compensated."""


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


class FreeFingers:
    """What the actuators of the fingers give, and what moving freely takes of it."""

    def __init__(self, hand: Hand) -> None:
        """Find the actuators that drive only joints of fingers; wrist and arm are left alone."""
        self._actuation = a = hand.actuation
        self._fingers = np.zeros(hand.nq, dtype=bool)
        for finger in hand.fingers.values():
            self._fingers[finger.q_index] = True
        drives = a.moment != 0
        self._alone = drives.any(axis=1) & ~(drives & ~self._fingers).any(axis=1)
        self._drag, self._stiction = joint_drag(hand)

    def _law(self, q: FloatArray, v: FloatArray) -> FloatArray:
        """Forces (nu,) of the actuators at joints (nq,) and rates (nq,) without a command."""
        a = self._actuation
        return np.asarray(
            a.bias[:, 0] + a.bias[:, 1] * (a.moment @ q + a.length0) + a.bias[:, 2] * (a.moment @ v)
        )

    def _free(
        self, q: FloatArray, v: FloatArray, weight: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Forces (nu,) that move a free hand, and how much of its dry friction (nq,) acts (-)."""
        sign = np.clip(v / FULL_FRICTION_RATE, -1.0, 1.0)
        torque = weight + self._drag * v + self._stiction * sign
        return self._actuation.split_torque(q, torque)[0], sign


CONTACT_TORQUE = 0.05
"""Torque (N m) that a finger's actuator may push with: 0.5 N at a tip 0.1 m from its joint, half of
what counts as a collision (``sim.verdict.COLLISION_N``)."""


class ContactForceLimit(FreeFingers):
    """Limits how hard the fingers of one hand push before they are to press."""

    def __init__(self, hand: Hand) -> None:
        """Prepare the limits of the actuators."""
        super().__init__(hand)
        size = np.abs(hand.actuation.moment).max(axis=1, initial=0.0)
        self._most = np.where(self._alone, CONTACT_TORQUE / np.where(size > 0, size, 1.0), np.inf)

    def commands(
        self, ctrl: FloatArray, q: FloatArray, v: FloatArray, weight: FloatArray
    ) -> FloatArray:
        """The commands (nu,) with no actuator pushing harder than ``CONTACT_TORQUE``.

        Args:
            ctrl: Commands (nu,).
            q: Joints as read (nq,).
            v: Their rates (nq,).
            weight: Joint torques (nq,) that hold the hand's weight, N m.
        """
        gain, law = self._actuation.gain, self._law(q, v)
        free, _ = self._free(q, v, weight)
        beyond = gain * ctrl + law - free
        if (np.abs(beyond) <= self._most).all():
            return ctrl
        return np.asarray((free + np.clip(beyond, -self._most, self._most) - law) / gain)


FAST = 0.3
"""Rate (rad/s) of an actuator's length from which on a step counts: six times that at which all of
a joint's dry friction acts."""

LEAST_TIME = 0.05
"""Time (s) that an actuator must have moved fast for its mean to count."""

LEAST_FRICTION = 0.005
"""Dry friction (N m) below which nothing is compensated: acceleration and damping leave up to 0.002
where there is none (eight closings of two hands); 0.02 beyond the model's are found as 0.020."""


class FrictionEstimate(FreeFingers):
    """The dry friction of one hand's finger joints, as far as it is known."""

    def __init__(self, hand: Hand) -> None:
        """Nothing is known yet."""
        super().__init__(hand)
        self._sum, self._size, self._time = np.zeros((3, len(hand.actuation.names)))

    def update(
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
        fast = self._alone & (np.abs(rate) > FAST)
        if not fast.any():
            return
        push = np.clip(a.gain * ctrl + self._law(q, v), *a.force_range.T)
        free, sign = self._free(q, v, weight)
        # of a tendon's two joints often one moves
        size = np.sign(rate) * (a.moment @ sign)
        fast &= size > 0.0
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
