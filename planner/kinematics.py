"""``HandState``: forward kinematics and Jacobians of a hand at one q; inverse ones of its arm.

A ``HandState`` proves that the kinematics at its q has been computed, and stays there; a
``MovingHand`` answers the same questions and goes from one q to the next, and ``moving_hand`` keeps
one in every thread. Everything is expressed in the hand's base frame; multiply by ``T_world_base``
to see it from the world.

Points move with the joints by Pinocchio's Jacobian J (6, nq), many at once: it has the velocity of
what passes the base's origin, and the angular velocity, for every joint; a joint counts for a point
only if it moves what carries the point.

``reach`` moves the arm that carries a hand: damped least squares within the joint limits. The task
of a step (``planner.numerics.least_squares``) is the twist e from the palm's pose to the wanted
one, with its Jacobian over the arm's joints, both in the palm's frame and rotations weighed by
``LEVER``; the damping |e|^2 + ``DAMPING`` vanishes with the error (Sugihara 2011, "Solvability-
unconcerned inverse kinematics by the Levenberg-Marquardt method"). One start can end in a local
minimum, so several are tried: the given posture, then random ones that are always the same.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from planner.arrays import finite_array, float_array
from planner.errors import HandError, ModelError, shown
from planner.hands.arm import Arm
from planner.hands.fingers import Finger
from planner.hands.hand import Hand
from planner.numerics.least_squares import Task, ik_step
from planner.spatial import SE3, FloatArray, IntArray, cross, skew
from planner.system.threads import kept_by_thread

__all__ = [
    "POSITION_TOL",
    "ROTATION_TOL",
    "HandKinematics",
    "HandState",
    "MovingHand",
    "Reach",
    "follow",
    "joint_axes",
    "palm_path",
    "palm_pose",
    "point_jacobians",
    "point_rates",
    "reach",
    "straight_path",
    "tip_reach",
]


class HandKinematics:
    """What can be asked of a hand whose kinematics have been computed at a configuration.

    Attributes:
        hand: The hand.
        q: The configuration (nq,), rad or m; read-only.
    """

    hand: Hand
    q: FloatArray
    pin_data: Any

    @property
    def T_base_palm(self) -> SE3:
        """Pose of the palm's body in the base."""
        return SE3(self.pin_data.oMf[self.hand.palm_frame_id])

    def tip_pose(self, finger: Finger) -> SE3:
        """Pose T_base_tip of a finger's tip frame."""
        return SE3(self.pin_data.oMf[finger.tip_frame_id])

    def joint_pose(self, joint_id: int) -> SE3:
        """Pose of a Pinocchio joint's frame in the base (0: identity)."""
        return SE3(self.pin_data.oMi[joint_id])

    def pad_center(self, finger: Finger) -> FloatArray:
        """Centre of a finger's pad in the base, (3,), m."""
        return np.array(self.pin_data.oMi[finger.pad.joint_id].act(finger.pad.center))

    def pad_axis(self, finger: Finger) -> FloatArray:
        """Direction a finger's pad faces in the base, (3,), unit."""
        return np.array(self.pin_data.oMi[finger.pad.joint_id].rotation @ finger.pad.axis)

    def tip_jacobian(self, finger: Finger) -> FloatArray:
        """Jacobian (6, n) of a tip frame over the finger's own joints (``finger.q_index``).

        Rows are [linear; angular] velocity of the tip's origin in the base's axes, m/rad and -.
        """
        full = pin.getFrameJacobian(
            self.hand.pin_model,
            self.pin_data,
            finger.tip_frame_id,
            pin.ReferenceFrame.LOCAL_WORLD_ALIGNED,
        )
        return np.array(full[:, finger.q_index])

    def point_jacobian(self, joint_id: int, point: FloatArray) -> FloatArray:
        """Jacobian (6, nq) of a point that moves with a joint.

        Args:
            joint_id: Pinocchio joint.
            point: (3,), m, in the base.

        Returns:
            Rows [linear velocity of the material point; angular velocity], base axes.
        """
        jac = np.array(
            pin.getJointJacobian(
                self.hand.pin_model, self.pin_data, joint_id, pin.ReferenceFrame.WORLD
            )
        )
        # WORLD: linear rows are the velocity of the point that passes the origin.
        jac[:3] -= skew(np.asarray(point, dtype=np.float64)) @ jac[3:]
        return jac

    def point_rates(
        self, joint_ids: IntArray, points: FloatArray, directions: FloatArray
    ) -> FloatArray:
        """Velocities of points along directions per joint velocity: rows of many Jacobians at once.

        Args:
            joint_ids: Pinocchio joints (k,) that the points move with.
            points: (k, 3), m, in the base.
            directions: (k, 3), base axes.

        Returns:
            (k, nq), direction_i . (Jacobian of point_i).
        """
        # not compiled: the solver's choices among equal directions follow the last digit of these
        rows = np.concatenate([directions, cross(points, directions)], axis=1)
        rates = rows @ self.pin_data.J
        return np.asarray(np.where(self.hand.moved_by[joint_ids], rates, 0.0))

    def point_jacobians(self, joint_ids: IntArray, points: FloatArray) -> FloatArray:
        """Jacobians (k, 6, nq) of points that move with joints, see ``point_jacobian``.

        Args:
            joint_ids: Pinocchio joints (k,).
            points: (k, 3), m, in the base.

        Raises:
            HandError: Other shapes, or joints that the hand does not have.
        """
        where = float_array("points", points, error=HandError)
        joints = np.asarray(joint_ids)
        if joints.dtype.kind not in "iu" or where.shape != (*joints.shape, 3) or joints.ndim != 1:
            raise HandError(
                f"points have shape {where.shape} and joint_ids {joints.shape} of {joints.dtype}; "
                "give (k, 3) and k integers"
            )
        if joints.size and not 0 <= joints.min() <= joints.max() < len(self.hand.moved_by):
            raise HandError(
                f"joint_ids are {shown(joint_ids)}; give numbers of Pinocchio joints, 0 to "
                f"{len(self.hand.moved_by) - 1}"
            )
        return point_jacobians(self.pin_data.J, self.hand.moved_by, joints, where)

    def pads(self, fingers: Sequence[Finger]) -> tuple[IntArray, FloatArray]:
        """Pinocchio joints (n,) that the fingers' pads move with, and the pads' centres (n, 3)."""
        joints = [f.pad.joint_id for f in fingers]
        poses = self.pin_data.oMi
        centers = [poses[j].act(f.pad.center) for j, f in zip(joints, fingers, strict=True)]
        return np.array(joints), np.array(centers)

    def gravity_torque(self, gravity_base: FloatArray) -> FloatArray:
        """Joint torques (nq,) that hold the hand against gravity (3,), m/s2, in base axes.

        tau = -sum_i m_i J_i^T g, with J_i the Jacobian of the centre of mass of link i.

        Raises:
            HandError: Gravity has another shape, or is not finite.
        """
        com_jacobian = pin.jacobianCenterOfMass(self.hand.pin_model, self.pin_data, self.q)
        moving_mass = float(self.pin_data.mass[0])
        gravity = finite_array("gravity_base", gravity_base, (3,), error=HandError)
        return np.array(-moving_mass * com_jacobian.T @ gravity)


class HandState(HandKinematics):
    """A hand at one configuration, which never changes."""

    def __init__(self, hand: Hand, q: FloatArray) -> None:
        """Compute placements and joint Jacobians at q (nq,).

        Raises:
            HandError: ``q`` has another shape, or is not finite.
        """
        self.hand = hand
        self.q = finite_array("q", q, (hand.nq,), error=HandError)
        self.pin_data = hand.pin_model.createData()
        self.q.flags.writeable = False
        _compute(self)


class MovingHand(HandKinematics):
    """A hand that is moved from one configuration to the next, in Pinocchio data made once.

    Making the data takes 0.1 ms, the kinematics 3 us. What is asked of it holds until it is moved:
    keep a ``HandState`` where that is too short.
    """

    def __init__(self, hand: Hand, q: FloatArray) -> None:
        """Begin at q (nq,).

        Raises:
            HandError: ``q`` has another shape, or is not finite.
        """
        self.hand = hand
        self.pin_data = hand.pin_model.createData()
        self.move(finite_array("q", q, (hand.nq,), error=HandError))

    def move(self, q: FloatArray) -> MovingHand:
        """Go to q (nq,); returns itself."""
        self.q = np.array(q, dtype=np.float64)
        self.q.flags.writeable = False
        _compute(self)
        return self


def _compute(state: HandKinematics) -> None:
    """Placements and joint Jacobians where it is now."""
    pin.computeJointJacobians(state.hand.pin_model, state.pin_data, state.q)
    pin.updateFramePlacements(state.hand.pin_model, state.pin_data)


def joint_axes(pin_model: Any) -> FloatArray:
    """Motion subspaces (njoints, 6), [linear; angular] in each joint's frame; row 0 is zero.

    A hinge has a unit angular axis, a slide a unit linear axis.

    Raises:
        ModelError: A joint has more than one degree of freedom.
    """
    data = pin_model.createData()
    pin.computeJointJacobians(pin_model, data, pin.neutral(pin_model))
    out = np.zeros((pin_model.njoints, 6))
    for j in range(1, pin_model.njoints):
        if pin_model.joints[j].nv != 1:
            raise ModelError(f"joint {pin_model.names[j]!r} is neither a hinge nor a slide")
        jac = pin.getJointJacobian(pin_model, data, j, pin.ReferenceFrame.LOCAL)
        out[j] = jac[:, pin_model.joints[j].idx_v]
    return out


@lru_cache(maxsize=8)
def tip_reach(hand: Hand) -> float:
    """How far (m/rad) a pad moves if all joints of its finger are off: the worst finger's.

    If errors of the joints are independent, each of standard deviation s, the place of a pad has
    the covariance s^2 J J^T; s times the largest singular value of J is its standard deviation in
    its worst direction. J (3, n) is taken in the middle of the joints' ranges.
    """
    state = HandState(hand, (hand.q_lower + hand.q_upper) / 2.0)
    reach = 0.0
    for finger in hand.fingers.values():
        jacobian = state.point_jacobian(finger.pad.joint_id, state.pad_center(finger))[:3]
        reach = max(reach, float(np.linalg.norm(jacobian[:, finger.q_index], 2)))
    return reach


def point_rates(
    jacobian: FloatArray,
    moved_by: NDArray[np.bool_],
    joint_ids: IntArray,
    points: FloatArray,
    directions: FloatArray,
) -> FloatArray:
    """Velocities (k, nq) of points along directions per joint velocity.

    Args:
        jacobian: J (6, nq).
        moved_by: Whether joint j moves what is fixed to Pinocchio joint i, (nq + 1, nq).
        joint_ids: Pinocchio joints (k,) that the points move with.
        points: (k, 3), m, in the base.
        directions: (k, 3), base axes.
    """
    rates = np.hstack([directions, cross(points, directions)]) @ jacobian
    return np.asarray(np.where(moved_by[joint_ids], rates, 0.0))


def point_jacobians(
    jacobian: FloatArray, moved_by: NDArray[np.bool_], joint_ids: IntArray, points: FloatArray
) -> FloatArray:
    """Jacobians (k, 6, nq) of points: [linear; angular] velocity, base axes.

    Args:
        jacobian: J (6, nq).
        moved_by: See ``point_rates``.
        joint_ids: Pinocchio joints (k,) that the points move with.
        points: (k, 3), m, in the base.
    """
    spin = jacobian[3:].T
    linear = jacobian[:3].T + cross(spin[None], points[:, None])
    both = np.concatenate([linear, np.broadcast_to(spin, linear.shape)], axis=2)
    return np.where(moved_by[joint_ids][:, None, :], both.transpose(0, 2, 1), 0.0)


@kept_by_thread(8)
def moving_hand(hand: Hand) -> MovingHand:
    """A hand that whoever asks next in this thread moves elsewhere.

    ``HandState(hand, q)`` makes Pinocchio's data anew, which takes 0.1 ms; ``.move(q)`` takes 5 us.
    Take what is needed out of it before any other function of this package is called.
    """
    return MovingHand(hand, hand.q_lower)


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

ARM_RATE, PEAK = 2.0, 1.875
"""Largest rate (rad/s) of an arm's joint, and that of a minimum-jerk profile beside its mean (-).
With a stretched elbow a turn of the wrist took 10 rad/s, the palm had 20 m/s^2, and a held cylinder
slipped by 12 mm (``manipulate allegro_on_arm7 cylinder:0.03x0.08 --attitude sideways``)."""

ARM_ACCELERATION = 2.0
"""Largest acceleration (rad/s^2) of an arm's joint between two pieces of a way. Where one came to
its end the others went on at other rates at once, and the palm had 2 m/s^2 and 17 rad/s^2: pads
slipped, and the friction that was believed from then on was too small for the turn."""

BRAKING = 0.5
"""Largest acceleration (m/s^2) of a palm before and after where it has to be slow."""

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
        hand: A hand on an arm, or two, whose palms go in step.
        q: Joints (nq,) where the path begins.
        shift: Where the palm goes from there (3,), m, in the axes of the base; of two hands also
            one for each (2, 3), of one length.
    """
    if hand.pair:
        ways = np.broadcast_to(shift, (len(hand.pair), 3))
        paths = [
            straight_path(side.alone, q[side.joints], side.T_base_root.rotation.T @ way)
            for side, way in zip(hand.pair, ways, strict=True)
        ]
        parts = [path for path in paths if path is not None]
        return np.hstack(parts) if len(parts) == len(paths) else None
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


def palm_paths(hand: Hand, q: FloatArray, goals: Iterable[SE3]) -> Iterator[FloatArray | None]:
    """Arm postures (m, n) to each pose in turn, as by ``palm_path``; None, last, where it cannot.

    Args:
        hand: A hand on an arm.
        q: Joints (nq,) where the first path begins.
        goals: Where the palm goes, one after the other, in the arm's root.
    """
    q = np.array(q)
    for goal in goals:
        path = palm_path(hand, q, goal)
        yield path
        if path is None:
            return
        q[_arm(hand).index] = path[-1]


def posture_times(way: FloatArray, duration: float) -> FloatArray:
    """Times (m,), s, at which an arm is at the postures (m, n) of a way of its palm.

    Evenly in a time (s), and later where a joint would pass ``ARM_RATE`` or ``ARM_ACCELERATION`` as
    the whole way is gone by a minimum-jerk profile; around there as ``BRAKING`` allows.
    """
    pieces = np.diff(way, axis=0)
    farthest = np.abs(pieces).max(axis=1)
    times = np.maximum(duration / len(farthest), PEAK * farthest / ARM_RATE)
    bent = PEAK * np.sqrt(np.abs(np.diff(pieces, axis=0)).max(axis=1) / ARM_ACCELERATION)
    times[1:], times[:-1] = np.maximum(times[1:], bent), np.maximum(times[:-1], bent)
    for back in (False, True):
        for k in range(1, len(times)):
            this, other = (-k - 1, -k) if back else (k, k - 1)
            rate = np.hypot(1.0 / times[other], np.sqrt(2.0 * BRAKING / PATH_STEP) / PEAK)
            times[this] = max(times[this], 1.0 / rate)
    return np.concatenate([[0.0], np.cumsum(times)])


def palm_pose(hand: Hand, q: FloatArray) -> SE3:
    """Pose of the palm's body in the base at q (nq,)."""
    data = hand.pin_model.createData()
    pin.framesForwardKinematics(hand.pin_model, data, np.asarray(q))
    return SE3(data.oMf[hand.palm_frame_id])


def palm_poses(hand: Hand, q: FloatArray) -> list[SE3]:
    """Poses in the base of the palm, or of both palms of two hands on arms, at q (nq,)."""
    if hand.pair:
        return [s.T_base_root * palm_pose(s.alone, q[s.joints]) for s in hand.pair]
    return [palm_pose(hand, q)]


def _arm(hand: Hand) -> Arm:
    if hand.arm is None:
        raise HandError(f"{hand.name} is not on an arm; load a hand that is, or describe a mount")
    return hand.arm
