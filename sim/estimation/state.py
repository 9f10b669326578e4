"""``Belief``: what the filter knows at one time, and how a linear measurement changes it.

Pose of the object in the hand's base, offsets of the joints that move the fingertips, and the
object's size. The error of the pose is right-invariant:

    T_base_object = exp(xi) estimate,    xi = [rho; phi], base axes,

so that a motion M of the object, T' = M T, turns the error as xi' = Ad_M xi, whatever the pose
is. (A. Barrau and S. Bonnabel, "The invariant extended Kalman filter as a stable observer", IEEE
Transactions on Automatic Control 62 (4), 2017.) A point x of the object is off by rho + phi x x.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from planner.spatial import SE3, FloatArray, skew


@dataclass(frozen=True, slots=True, eq=False)
class Belief:
    """An estimate and the covariance of its error [xi (6); offsets (m); size (1)].

    Attributes:
        T_base_object: Pose of the object in the hand's base.
        offsets: (m,), reading minus joint, rad or m, of the joints that the filter looks at.
        size: Growth of all lengths of the object, relative to the believed size (-).
        covariance: (7 + m, 7 + m).
    """

    T_base_object: SE3
    offsets: FloatArray
    size: float
    covariance: FloatArray

    def moved(
        self, motion: FloatArray, by_offsets: FloatArray, noise: FloatArray, drift: FloatArray
    ) -> Belief:
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
        return Belief(M * self.T_base_object, self.offsets, self.size, moved)

    def corrected(self, residual: FloatArray, jacobian: FloatArray, noise: FloatArray) -> Belief:
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

    def _shifted(self, error: FloatArray, covariance: FloatArray) -> Belief:
        pose = pin.exp6(pin.Motion(error[:6])) * self.T_base_object
        return Belief(pose, self.offsets + error[6:-1], self.size + float(error[-1]), covariance)

    def beyond(self, other: Belief) -> FloatArray:
        """The error (7 + m,) of another estimate, if this one is true."""
        pose = other.off(self.T_base_object)
        return np.concatenate([pose, self.offsets - other.offsets, [self.size - other.size]])

    def off(self, measured: SE3) -> FloatArray:
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
