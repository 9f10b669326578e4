"""``Estimate``: what the filter knows at one time, and how a linear measurement changes it.

Pose of the object in the hand's base, offsets of the joints that move the fingertips, and the
object's size. The error of the pose is right-invariant:

    T_base_object = exp(xi) estimate,    xi = [rho; phi], base axes,

so that a motion M of the object, T' = M T, turns the error as xi' = Ad_M xi, whatever the pose
is. (A. Barrau and S. Bonnabel, "The invariant extended Kalman filter as a stable observer", IEEE
Transactions on Automatic Control 62 (4), 2017.) A point x of the object is off by rho + phi x x.

``SensorErrors``: how far an estimator trusts its senses. Each number is a standard deviation.

An estimator knows what data sheets and calibrations say: how large errors are, never what was
drawn of them.

``SensorSample``: what the senses said at one time; ``PoseMeasurement``: a pose that was measured.

``rolling``: how an object moves in a hand whose fingertips move, by contacts that stick.

Where a contact sticks, object and fingertip have one velocity there (rolling contact: D. J.
Montana, "The kinematics of contact and grasp", International Journal of Robotics Research 7 (3),
1988). Over a short time, with d = [v; w] the displacement of the object about the base's origin,
u_i = J_i dq that of fingertip i at contact p_i, and s_i what the pad says that it slid:

    v + w x p_i = u_i + s_i + noise,    n_i . w = n_i . w_i + noise

The second says that a soft tip resists spinning. Weighted least squares gives d; its normal matrix
is the information on it. What carries the object beside the fingers is a prior of d: on a table it
stands still, in the air nothing is known.

``TipKinematics``: fingertips at joints, and how their velocities change with the joints. Jacobians
are of points that are fixed in the frames of the pads' joints, over the joints that move any of the
fingers that take part.

``touch_equations``: contacts lie on the object's surface, and pads feel its normal. With the signed
distance f of the object's shape, grown by the share s, and a contact p_i, or the centre of a round
tip of radius r_i:

    (1 + s) f(x_i) = r_i,    x_i = T^-1 p_i / (1 + s);    outward normal of the shape at x_i = m_i
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from planner.arrays import check_fields
from planner.hands.fingers import Finger
from planner.hands.hand import Hand
from planner.kinematics import MovingHand
from planner.shapes.base import Shape
from planner.spatial import SE3, FloatArray, IntArray, contact_frames, cross, skew
from sim.sensing.errors import ErrorModel

LEAST_CAMERA, LEAST_TURN = 2e-4, math.radians(0.2)
"""Least errors of a camera, m and rad, that an estimator believes: a better one would be believed
against the contacts, which give way by as much."""

LEAST_OFFSET = math.radians(0.3)
"""Least offset of a joint (rad) that an estimator allows for."""


@dataclass(frozen=True, kw_only=True)
class SensorErrors:
    """Errors that an estimator expects.

    Attributes:
        camera: White noise of a measured position, each axis, m.
        camera_turn: White noise of a measured rotation, each axis, rad.
        drift: Correlated noise of a measured position, m.
        drift_turn: Correlated noise of a measured rotation, rad.
        drift_time: Correlation time of what drifts, s.
        joint_offset: Constant offset of a joint, rad.
        joint_scale: Scale error of a joint (-).
        size: Error of all lengths of the object, as a share (-).
        sliding: White noise of a pad's sliding velocity, each axis, m/s.
        place: Correlated noise of where a pad feels a contact, each axis along the pad, m.
        touch_age: Largest age of what a pad says, s.
    """

    camera: float = 0.001
    camera_turn: float = math.radians(1.0)
    drift: float = 0.0
    drift_turn: float = 0.0
    drift_time: float = 1.0
    joint_offset: float = math.radians(1.0)
    joint_scale: float = 0.0
    size: float = 0.0
    sliding: float = 0.0
    place: float = 0.0
    touch_age: float = 0.0

    def __post_init__(self) -> None:
        """Check every number."""
        check_fields(self, what="sensor errors: ", least=0.0)

    @classmethod
    def of(cls, error_model: ErrorModel | None) -> SensorErrors:
        """What the data sheets of an error model say; those of no error model if None."""
        r = error_model or ErrorModel()
        return cls(
            camera=max(LEAST_CAMERA, math.hypot(r.pose_noise, r.pose_bias)),
            camera_turn=max(LEAST_TURN, math.hypot(r.turn_noise, r.turn_bias)),
            drift=r.pose_drift,
            drift_turn=r.turn_drift,
            drift_time=r.drift_time,
            joint_offset=max(LEAST_OFFSET, r.encoder_offset),
            joint_scale=r.encoder_scale,
            size=r.object_size / math.sqrt(3.0),
            sliding=r.sliding_noise,
            place=r.touch_place,
            touch_age=r.touch_delay + (1.0 / r.touch_rate if r.touch_rate else 0.0),
        )


@dataclass(frozen=True, slots=True, eq=False)
class PoseMeasurement:
    """A measured pose of the object in the hand's base.

    Attributes:
        T_base_object: What was measured.
        camera: Number of this measurement, from 0: errors of neighbours are alike.
        period: Time since the one before, s.
    """

    T_base_object: SE3
    camera: int
    period: float


@dataclass(frozen=True, slots=True, eq=False)
class SensorSample:
    """Senses at one time; n fingers that take part, in the frames of their pads' joints.

    Attributes:
        time: s.
        q: (nq,), joints as read, rad or m.
        T_world_base: Pose of the hand's base.
        standing: Whether the object stands in the world; else the hand carries it.
        touching: (n,), which fingers touch.
        points: (n, 3), contacts, m; zeros where nothing is felt, or not where.
        normals: (n, 3), into the object; zeros there.
        sliding: (n, 3), velocity of the object over the pad, m/s; zeros there.
    """

    time: float
    q: FloatArray
    T_world_base: SE3
    standing: bool
    touching: NDArray[np.bool_]
    points: FloatArray
    normals: FloatArray
    sliding: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """An estimate and the covariance of its error [xi (6); offsets (m); size (1)].

    Attributes:
        T_base_object: Pose of the object in the hand's base.
        offsets: (m,), reading minus joint, rad or m, of the joints that the filter estimates.
        size: Growth of all lengths of the object, relative to the believed size (-).
        covariance: (7 + m, 7 + m).
    """

    T_base_object: SE3
    offsets: FloatArray
    size: float
    covariance: FloatArray

    def moved(
        self, motion: FloatArray, by_offsets: FloatArray, noise: FloatArray, drift: FloatArray
    ) -> Estimate:
        """After a motion of the object.

        Args:
            motion: Logarithm (6,) of M, base axes.
            by_offsets: (6, m), how the motion changes with the offsets' errors.
            noise: (6, 6), covariance of the motion's own error.
            drift: (m,), variance by which the offsets wander meanwhile.
        """
        M = pin.exp6(pin.Motion(motion))
        P, k = self.covariance, 6 + len(self.offsets)
        turn = M.action
        of_pose = turn @ P[:6] + by_offsets @ P[6:k]
        moved = P.copy()
        moved[:6] = of_pose
        moved[:, :6] = of_pose.T
        moved[:6, :6] = of_pose[:, :6] @ turn.T + of_pose[:, 6:k] @ by_offsets.T + noise
        diagonal = np.einsum("ii->i", moved)
        diagonal[6:k] += drift
        return Estimate(M * self.T_base_object, self.offsets, self.size, moved)

    def corrected(self, residual: FloatArray, jacobian: FloatArray, noise: FloatArray) -> Estimate:
        """After a measurement: residual = jacobian error + noise.

        Args:
            residual: (k,), measured minus expected.
            jacobian: (k, 7 + m).
            noise: (k, k), covariance.
        """
        P = self.covariance
        cross = jacobian @ P
        spread = cross @ jacobian.T + noise
        gain = np.linalg.solve(spread, cross).T
        error = gain @ residual
        after = P - gain @ cross
        after = 0.5 * (after + after.T)
        return self._shifted(error, after)

    def _shifted(self, error: FloatArray, covariance: FloatArray) -> Estimate:
        pose = pin.exp6(pin.Motion(error[:6])) * self.T_base_object
        return Estimate(pose, self.offsets + error[6:-1], self.size + float(error[-1]), covariance)

    def error_against(self, other: Estimate) -> FloatArray:
        """The error (7 + m,) of another estimate, if this one is true."""
        pose = other.error_to(self.T_base_object)
        return np.concatenate([pose, self.offsets - other.offsets, [self.size - other.size]])

    def error_to(self, measured: SE3) -> FloatArray:
        """Logarithm (6,) of a measured pose relative to the estimate, base axes."""
        return np.array(pin.log6(measured * self.T_base_object.inverse()).vector)

    def pose_covariance(self) -> FloatArray:
        """(6, 6), of the position of the object's origin, m, and the rotation vector, rad."""
        to_origin = about_origin(self.T_base_object.translation)
        return np.asarray(to_origin @ self.covariance[:6, :6] @ to_origin.T)


def about_origin(point: FloatArray) -> FloatArray:
    """(6, 6): error xi of a pose -> displacement of a point (3,) of it, and rotation vector."""
    out = np.eye(6)
    out[:3, 3:] = -skew(point)
    return out


@dataclass(frozen=True, slots=True, eq=False)
class Tips:
    """Frames of n pads' joints in the hand's base, and what the joints do to them.

    Attributes:
        rotations: (n, 3, 3).
        origins: (n, 3), m.
        linear: (n, m, 3), velocity of the point at the base's origin per joint rate.
        angular: (n, m, 3), angular velocity per joint rate.
    """

    rotations: FloatArray
    origins: FloatArray
    linear: FloatArray
    angular: FloatArray

    def of(self, fingers: IntArray) -> Tips:
        """Those of some of the fingers only."""
        return Tips(*(getattr(self, name)[fingers] for name in self.__slots__))

    def out(self, local: FloatArray) -> FloatArray:
        """Points (n, 3) of the pads' frames in the base."""
        return np.asarray((self.rotations @ local[:, :, None])[:, :, 0] + self.origins)

    def turned(self, local: FloatArray) -> FloatArray:
        """Vectors (n, 3) of the pads' frames in the base's axes."""
        return np.asarray((self.rotations @ local[:, :, None])[:, :, 0])

    def into(self, points: FloatArray) -> FloatArray:
        """Points (n, 3) of the base in the pads' frames."""
        return np.asarray(((points - self.origins)[:, None, :] @ self.rotations)[:, 0])

    def turned_into(self, vectors: FloatArray) -> FloatArray:
        """Vectors (n, 3) of the base in the pads' axes."""
        return np.asarray((vectors[:, None, :] @ self.rotations)[:, 0])

    def jacobians(self, points: FloatArray) -> FloatArray:
        """(n, m, 3), velocity of points (n, 3) that move with the pads, per joint rate."""
        return np.asarray(self.linear + cross(self.angular, points[:, None, :]))

    def bending(self, points: FloatArray, moved: FloatArray) -> FloatArray:
        """How displacements J(q) moved of points change with q: (n, m, 3).

        A joint turns the axes of those beyond it, and moves the point.

        Args:
            points: (n, 3), m.
            moved: (m,), change of the joints, rad or m.
        """
        linear, angular = self.linear * moved[:, None], self.angular * moved[:, None]
        whole = angular.sum(axis=1, keepdims=True)
        # of the joints beyond each: the chain's order is that of the joints
        v = linear.sum(axis=1, keepdims=True) - np.cumsum(linear, axis=1)
        w = whole - np.cumsum(angular, axis=1)
        turned = cross(self.angular, v) + cross(self.linear, w)
        turned += cross(cross(self.angular, w), points[:, None, :])
        return np.asarray(turned + cross(whole, self.jacobians(points)))


class TipKinematics:
    """Fingertips of a hand that moves.

    Attributes:
        index: (m,), where the joints that move any of the fingers stand in q.
    """

    def __init__(self, hand: Hand, fingers: Sequence[Finger]) -> None:
        """Prepare for fingers."""
        self._state = MovingHand(hand, hand.neutral)
        self._joints = [finger.pad.joint_id for finger in fingers]
        moved = np.array(hand.moved_by[self._joints])
        self.index = np.flatnonzero(moved.any(axis=0))
        self._moved = moved[:, self.index, None]

    def at(self, q: FloatArray) -> Tips:
        """The fingertips at joints (nq,)."""
        data = self._state.move(q).pin_data
        poses = [data.oMi[j] for j in self._joints]
        columns = data.J[:, self.index].T
        return Tips(
            np.array([pose.rotation for pose in poses]),
            np.array([pose.translation for pose in poses]),
            self._moved * columns[:, :3],
            self._moved * columns[:, 3:],
        )


STEP = 1e-4
"""Step (m) of the differences that give the curvature of a surface."""


@dataclass(frozen=True, slots=True, eq=False)
class Equations:
    """residual = jacobian error + noise, of distances first, then of normals.

    Attributes:
        residual: (k,), m, then rad.
        jacobian: (k, 7 + m).
        distances: How many of the rows are distances.
    """

    residual: FloatArray
    jacobian: FloatArray
    distances: int


def nearest(shape: Shape, estimate: Estimate, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Signed distances (k,), m, and outward normals (k, 3), base axes, at points (k, 3) there."""
    T, grown = estimate.T_base_object, 1.0 + estimate.size
    local = (points - T.translation) @ T.rotation / grown
    surface, normals = shape.closest_point(local)
    distance = grown * ((local - surface) * normals).sum(axis=1)
    return distance, np.asarray(normals @ T.rotation.T)


def touch_equations(
    shape: Shape,
    estimate: Estimate,
    tips: Tips,
    points: FloatArray,
    radii: FloatArray,
    felt: FloatArray | None,
) -> Equations:
    """What contacts say of pose, offsets and size.

    Args:
        shape: The object's.
        estimate: What is known.
        tips: Fingertips of the k fingers that touch, at the joints as they are believed.
        points: (k, 3), contacts, or centres of round tips, m, base.
        radii: (k,), 0 or the tips' radii, m.
        felt: (k, 3), outward normals as the pads feel them; None if they do not.
    """
    k, m = len(points), len(estimate.offsets)
    center = estimate.T_base_object.translation
    if felt is None:
        distance, normals = nearest(shape, estimate, points)
    else:
        frames = contact_frames(felt)  # the surface's own would jump with it
        across = frames[:, :, 1:].transpose(0, 2, 1)  # (k, 2, 3)
        beside = points[:, None] + STEP * across
        distance, normals = nearest(
            shape, estimate, np.concatenate([points, beside.reshape(-1, 3)])
        )
        distance, normals, near = distance[:k], normals[:k], normals[k:].reshape(k, 2, 3)
    jacobians = tips.jacobians(points)  # (k, m, 3)
    rows = np.empty((k, 7 + m))
    rows[:, :3] = -normals
    rows[:, 3:6] = -cross(points, normals)
    rows[:, 6:-1] = -(jacobians @ normals[:, :, None])[:, :, 0]
    arm = points - center
    rows[:, -1] = (distance - (normals * arm).sum(axis=1)) / (1.0 + estimate.size)
    if felt is None:
        return Equations(radii - distance, rows, k)
    bend = ((near - normals[:, None]) / STEP).transpose(0, 2, 1) @ across  # (k, 3, 3)
    turning = np.empty((k, 3, 7 + m))
    turning[:, :, :3] = -bend
    turning[:, :, 3:6] = bend @ skew(points) - skew(normals)
    turning[:, :, 6:-1] = -bend @ jacobians.transpose(0, 2, 1)
    turning[:, :, 6:-1] -= skew(felt) @ tips.angular.transpose(0, 2, 1)
    turning[:, :, -1] = -(bend @ arm[:, :, None])[:, :, 0] / (1.0 + estimate.size)
    of_normals = (across @ turning).reshape(2 * k, -1)
    off = (across @ (felt - normals)[:, :, None]).reshape(-1)
    return Equations(np.concatenate([radii - distance, off]), np.concatenate([rows, of_normals]), k)


@dataclass(frozen=True, slots=True, eq=False)
class Grip:
    """Contacts over a short time: n fingers, in the base.

    Attributes:
        points: (n, 3), m; of fingers that do not touch, anything finite.
        normals: (n, 3), unit, into the object.
        slid: (n, 3), displacement of the object over the pad, m.
        stick: (n,), 1 / variance of a displacement between object and pad, 1/m2; 0 without contact.
        spin: (n,), 1 / variance of a turn about the normal, 1/rad2; 0 without contact.
    """

    points: FloatArray
    normals: FloatArray
    slid: FloatArray
    stick: FloatArray
    spin: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """A displacement of the object, [linear; angular] about the base's origin, base axes.

    Attributes:
        displacement: (6,), m and rad.
        covariance: (6, 6), of its error.
        by_joints: (6, m), per displacement of the joints.
        rest_rate: (6,), per second, what does not come from the joints: prior and sliding.
        by_offsets: (6, m), error of the displacement per error of the joints' offsets.
    """

    displacement: FloatArray
    covariance: FloatArray
    by_joints: FloatArray
    rest_rate: FloatArray
    by_offsets: FloatArray


def rolling(
    tips: Tips,
    jacobians: FloatArray,
    grip: Grip,
    moved: FloatArray,
    prior: FloatArray,
    information: FloatArray,
    elapsed: float,
) -> Motion:
    """The displacement of an object.

    Args:
        tips: Fingertips, in the middle of the motion.
        jacobians: (n, m, 3), ``tips.jacobians`` of the contacts.
        grip: Contacts.
        moved: (m,), displacement of the joints, rad or m.
        prior: (6,), displacement if no finger touched.
        information: (6, 6), inverse covariance of that; positive definite.
        elapsed: Time that it takes, s.
    """
    points, normals = grip.points, grip.normals
    n, m = len(points), len(moved)
    held = np.empty((n, 3, 6))
    held[:, :, :3] = np.eye(3)
    held[:, :, 3:] = -skew(points)
    weighted = (grip.stick[:, None, None] * held).reshape(-1, 6)
    weights = information + weighted.T @ held.reshape(-1, 6)
    turning = grip.spin[:, None] * normals
    weights[3:, 3:] += turning.T @ normals
    along = (tips.angular @ normals[:, :, None])[:, :, 0]  # (n, m)
    rows = jacobians.transpose(0, 2, 1).reshape(3 * n, m)
    by_joints = weighted.T @ rows
    by_joints[3:] += turning.T @ along
    covariance = np.linalg.inv(weights)
    by_joints = covariance @ by_joints
    rest = covariance @ (information @ prior + weighted.T @ grip.slid.ravel())
    displacement = by_joints @ moved + rest
    # true joints are q - offset - error, and the contacts move with them
    turned = np.broadcast_to(displacement[3:], jacobians.shape)
    wrong = cross(turned, jacobians) - tips.bending(points, moved)
    by_offsets = covariance @ (weighted.T @ wrong.transpose(0, 2, 1).reshape(3 * n, m))
    return Motion(
        displacement,
        np.asarray(covariance, dtype=np.float64),
        by_joints,
        rest / elapsed,
        by_offsets,
    )
