"""Inverse kinematics of the arm that carries a hand: damped least squares within the joint limits.

The task of a step (``planner.numerics.qp``) is the twist e from the palm's pose to the wanted
one, with its Jacobian over the arm's joints, both in the palm's frame and rotations weighed by
``LEVER``; the damping |e|^2 + ``DAMPING`` vanishes with the error (Sugihara 2011, "Solvability-
unconcerned inverse kinematics by the Levenberg-Marquardt method").

One start can end in a local minimum, so ``reach`` tries several: the given posture, then random
ones that are always the same.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from planner.errors import HandError
from planner.hands.arm import Arm
from planner.hands.hand import Hand
from planner.numerics.qp import Task, ik_step
from planner.spatial import SE3, FloatArray

__all__ = [
    "POSITION_TOL",
    "ROTATION_TOL",
    "Reach",
    "follow",
    "palm_path",
    "palm_pose",
    "reach",
    "straight_path",
]

POSITION_TOL = 1e-5
"""Distance (m) from the wanted place that counts as being there: far below what a pad's touch
needs."""

ROTATION_TOL = 1e-4
"""The same for the angle, rad: 0.02 mm at a fingertip 0.2 m away."""

LEVER = 0.2
"""Length (m) by which angles are made comparable to distances: a hand's size."""

DAMPING = 1e-6
"""Damping (m2) that is left at the goal; keeps a stretched arm from swinging."""

STEPS = 60
"""Most steps from one start."""

RESTARTS = 6
"""Random starts after the given one."""

PATH_STEP = 0.01
"""Distance (m) between two postures of a straight path; a palm that moves linearly in the joints
between them leaves the line by less than 0.1 mm."""

ROUNDING = 1e-9
"""A way longer than a whole number of steps by this share of one (-) has that number."""

LARGEST_TURN = 0.35
"""Largest change (rad, m) of a joint between two postures of a path: more is a flip of the arm into
another of its configurations, not a motion along a line."""


@dataclass(frozen=True, kw_only=True)
class Reach:
    """How near the arm gets.

    Attributes:
        q: All joints (nq,); those of the arm moved.
        distance: What is left, m.
        angle: What is left, rad.
    """

    q: FloatArray
    distance: float
    angle: float

    @property
    def there(self) -> bool:
        """Whether the palm is where it was wanted."""
        return self.distance <= POSITION_TOL and self.angle <= ROTATION_TOL


def reach(hand: Hand, T_base_palm: SE3, q: FloatArray, *, restarts: int = RESTARTS) -> Reach:
    """Joints that put the palm at a pose, from several starts; the nearest if none gets there.

    Args:
        hand: A hand on an arm.
        T_base_palm: Wanted pose of the palm's body in the arm's root.
        q: First start (nq,); joints that are not the arm's stay.
        restarts: Random starts after it.

    Raises:
        HandError: No arm carries the hand.
    """
    chain = _arm(hand).chain
    best = follow(hand, T_base_palm, q)
    rng = np.random.default_rng(0)
    for _ in range(restarts):
        if best.there:
            break
        start = np.array(q, dtype=np.float64)
        start[chain] = rng.uniform(hand.q_lower[chain], hand.q_upper[chain])
        other = follow(hand, T_base_palm, start)
        if other.distance + LEVER * other.angle < best.distance + LEVER * best.angle:
            best = other
    return best


def follow(hand: Hand, T_base_palm: SE3, q: FloatArray) -> Reach:
    """Joints near q (nq,) that put the palm at a pose, from this one start; see ``reach``."""
    chain = _arm(hand).chain
    model, data, frame = hand.pin_model, hand.pin_model.createData(), hand.palm_frame_id
    q = np.array(q, dtype=np.float64)
    lower, upper = hand.q_lower[chain], hand.q_upper[chain]
    weight = np.array([1.0, 1.0, 1.0, LEVER, LEVER, LEVER])
    best = Reach(q=q.copy(), distance=np.inf, angle=np.inf)
    for _ in range(STEPS):
        pin.computeJointJacobians(model, data, q)
        palm = pin.updateFramePlacement(model, data, frame)
        jacobian = pin.getFrameJacobian(model, data, frame, pin.ReferenceFrame.LOCAL)
        error = np.array(pin.log6(palm.inverse() * T_base_palm).vector)
        gap = T_base_palm.translation - palm.translation
        now = Reach(
            q=q.copy(),
            distance=float(np.linalg.norm(gap)),
            angle=float(np.linalg.norm(error[3:])),
        )
        if now.distance + LEVER * now.angle < best.distance + LEVER * best.angle:
            best = now
        if now.there:
            break
        task = Task(weight[:, None] * jacobian[:, chain], weight * error)
        damping = float(task.error @ task.error) + DAMPING
        q[chain] = ik_step(task, q[chain], lower, upper, damping=damping)
    return best


def straight_path(hand: Hand, q: FloatArray, shift: FloatArray) -> FloatArray | None:
    """Arm postures (m, n) along which the palm moves straight without turning; None if it cannot.

    Args:
        hand: A hand on an arm.
        q: Joints (nq,) where the path begins.
        shift: Where the palm goes from there (3,), m, in the axes of the arm's root.
    """
    begin = palm_pose(hand, q)
    return palm_path(hand, q, SE3(begin.rotation, begin.translation + shift))


def palm_path(hand: Hand, q: FloatArray, T_base_palm: SE3) -> FloatArray | None:
    """Arm postures (m, n) along which the palm moves straight to a pose; None if it cannot.

    Args:
        hand: A hand on an arm.
        q: Joints (nq,) where the path begins.
        T_base_palm: Where the palm goes, in the arm's root; it turns evenly on the way.
    """
    chain, index = _arm(hand).chain, _arm(hand).index
    begin = palm_pose(hand, q)
    shift = T_base_palm.translation - begin.translation
    turn = pin.log3(T_base_palm.rotation @ begin.rotation.T)
    far = max(np.linalg.norm(shift), LEVER * np.linalg.norm(turn))
    count = max(1, int(np.ceil(far / PATH_STEP - ROUNDING)))
    q = np.array(q, dtype=np.float64)
    path = [q[index].copy()]
    for share in np.arange(1, count + 1) / count:
        rotation = pin.exp3(share * turn) @ begin.rotation
        reached = follow(hand, SE3(rotation, begin.translation + share * shift), q)
        if not reached.there or np.abs(reached.q[chain] - q[chain]).max() > LARGEST_TURN:
            return None
        q = reached.q
        path.append(q[index].copy())
    return np.array(path)


def palm_pose(hand: Hand, q: FloatArray) -> SE3:
    """Pose of the palm's body in the base at q (nq,)."""
    data = hand.pin_model.createData()
    pin.framesForwardKinematics(hand.pin_model, data, np.asarray(q))
    return SE3(data.oMf[hand.palm_frame_id])


def _arm(hand: Hand) -> Arm:
    if hand.arm is None:
        raise HandError(f"{hand.name} is not on an arm; load a hand that is, or describe a mount")
    return hand.arm
