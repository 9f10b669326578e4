"""How points of a hand move with its joints, many at once, from Pinocchio's Jacobian.

The Jacobian J (6, nq) has the velocity of what passes the base's origin, and the angular velocity,
for every joint; a joint counts for a point only if it moves what carries the point.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner.spatial import FloatArray, IntArray, cross

__all__ = ["point_jacobians", "point_rates"]


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
