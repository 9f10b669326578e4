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
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from planner.arrays import check_fields
from planner.spatial import SE3, FloatArray, skew
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
