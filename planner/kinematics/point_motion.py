"""How points of a hand move with its joints, many at once, from Pinocchio's Jacobian.

The Jacobian J (6, nq) has the velocity of what passes the base's origin, and the angular velocity,
for every joint; a joint counts for a point only if it moves what carries the point.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner.numerics.kernels import kernel
from planner.spatial import FloatArray, IntArray, cross

__all__ = ["point_jacobians", "point_rates"]


def _rates_plain(
    jacobian: FloatArray,
    moved_by: NDArray[np.bool_],
    joint_ids: IntArray,
    points: FloatArray,
    directions: FloatArray,
) -> FloatArray:
    """``point_rates`` in NumPy."""
    rates = np.hstack([directions, cross(points, directions)]) @ jacobian
    return np.asarray(np.where(moved_by[joint_ids], rates, 0.0))


@kernel(_rates_plain)
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
    nq = jacobian.shape[1]
    out = np.zeros((len(points), nq))
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        u, v, w = directions[i, 0], directions[i, 1], directions[i, 2]
        mx, my, mz = y * w - z * v, z * u - x * w, x * v - y * u
        for j in range(nq):
            if moved_by[joint_ids[i], j]:
                linear = u * jacobian[0, j] + v * jacobian[1, j] + w * jacobian[2, j]
                angular = mx * jacobian[3, j] + my * jacobian[4, j] + mz * jacobian[5, j]
                out[i, j] = linear + angular
    return out


def _jacobians_plain(
    jacobian: FloatArray, moved_by: NDArray[np.bool_], joint_ids: IntArray, points: FloatArray
) -> FloatArray:
    """``point_jacobians`` in NumPy."""
    spin = jacobian[3:].T
    linear = jacobian[:3].T + cross(spin[None], points[:, None])
    both = np.concatenate([linear, np.broadcast_to(spin, linear.shape)], axis=2)
    return np.where(moved_by[joint_ids][:, None, :], both.transpose(0, 2, 1), 0.0)


@kernel(_jacobians_plain)
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
    nq = jacobian.shape[1]
    out = np.zeros((len(points), 6, nq))
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        for j in range(nq):
            if moved_by[joint_ids[i], j]:
                u, v, w = jacobian[3, j], jacobian[4, j], jacobian[5, j]
                out[i, 0, j] = jacobian[0, j] + v * z - w * y
                out[i, 1, j] = jacobian[1, j] + w * x - u * z
                out[i, 2, j] = jacobian[2, j] + u * y - v * x
                out[i, 3, j], out[i, 4, j], out[i, 5, j] = u, v, w
    return out
