"""Joints between two knots: pads go evenly from contact to contact over the object's surface.

With joints that move evenly the pads would leave the surface by up to a millimetre, and slide.
Here the centre of every pad is led along the object: evenly from knot to knot in the object's
frame, one radius off the surface; the joints follow by the least steps,

    min |dq|  s.t.  J_i dq = wanted_i - c_i,   C dq = d - C q.
"""

from __future__ import annotations

import numpy as np

from planner.kinematics import MovingHand
from planner.spatial import SE3, FloatArray
from planner.task import GraspTask

__all__ = ["lead"]

STEPS = 6
"""Most steps; two or three are usual."""

ARRIVED = 1e-6
"""Distance (m) from where a pad is wanted that is none."""

RCOND = 1e-3
"""Singular values below this share of the largest count as zero: a finger that is stretched cannot
follow exactly, and need not for a fraction of a millimetre."""


def lead(
    task: GraspTask,
    ends: tuple[SE3, SE3],
    postures: tuple[FloatArray, FloatArray],
    T_object_base: SE3,
    share: float,
) -> FloatArray:
    """Joints (nq,) at a share of the way between two knots.

    Args:
        task: Hand, fingers and object.
        ends: Base in the object's frame at both knots.
        postures: Joints (nq,) at both knots.
        T_object_base: Base in the object's frame at the share.
        share: 0 to 1.
    """
    hand = task.hand
    moving = MovingHand(hand, postures[0])
    centers = [
        np.array([pose.act(moving.move(q).pad_center(f)) for f in task.fingers])
        for pose, q in zip(ends, postures, strict=True)
    ]
    points, outward = task.object.shape.closest_point(
        centers[0] + share * (centers[1] - centers[0])
    )
    radii = np.array([f.pad.radius for f in task.fingers])
    to_base = T_object_base.inverse()
    wanted = np.array([to_base.act(c) for c in points + radii[:, None] * outward])
    matrix, value = hand.coupling_matrix
    q = postures[0] + share * (postures[1] - postures[0])
    index = np.flatnonzero(np.abs(matrix).sum(axis=0) > 0)
    index = np.union1d(index, np.concatenate([f.q_index for f in task.fingers]))
    index = np.setdiff1d(index, hand.wrist_index)
    for _ in range(STEPS):
        moving.move(q)
        now = np.array([moving.pad_center(f) for f in task.fingers])
        missing = np.concatenate([(wanted - now).ravel(), value - matrix @ q])
        if np.abs(missing).max() <= ARRIVED:
            break
        rows = [moving.point_jacobian(f.pad.joint_id, c)[:3] for f, c in zip(task.fingers, now, strict=True)]
        jacobian = np.vstack([*rows, matrix])[:, index]
        step = np.linalg.lstsq(jacobian, missing, rcond=RCOND)[0]
        q = q.copy()
        q[index] = np.clip(q[index] + step, hand.q_lower[index], hand.q_upper[index])
    return q
