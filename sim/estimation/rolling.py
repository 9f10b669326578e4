"""``rolling``: how an object moves in a hand whose fingertips move, by contacts that stick.

Where a contact sticks, object and fingertip have one velocity there (rolling contact: D. J.
Montana, "The kinematics of contact and grasp", International Journal of Robotics Research 7 (3),
1988). Over a short time, with d = [v; w] the displacement of the object about the base's origin,
u_i = J_i dq that of fingertip i at contact p_i, and s_i what the pad says that it slid:

    v + w x p_i = u_i + s_i + noise,    n_i . w = n_i . w_i + noise

The second says that a soft tip resists spinning. Weighted least squares gives d; its normal matrix
is the information on it. What carries the object beside the fingers is a prior of d: on a table it
stands still, in the air nothing is known.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planner.spatial import FloatArray, cross, skew
from sim.estimation.tips import Tips


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
