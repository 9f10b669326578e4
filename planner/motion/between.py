"""Joints between two knots: the pads roll evenly from contact to contact over the object's surface.

With joints that move evenly the pads would leave the surface by up to a millimetre, and slide.
Here the centre of every pad is led along the object, one radius off its surface; the joints follow
by the least steps,

    min |dq|  s.t.  J_i dq = wanted_i - c_i,   C dq = d - C q.

First the centres go evenly from knot to knot. How far the tips would then roll from place to place
(``planner.motion.rolling``) tells how far the centres have to go there, and they are led again.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from planner.kinematics import MovingHand
from planner.spatial import SE3, FloatArray
from planner.task import GraspTask

__all__ = ["lead"]

STEPS = 6
"""Most steps of the joints; two or three are usual."""

ARRIVED = 1e-6
"""Distance (m) from where a pad is wanted that is none."""

RCOND = 1e-3
"""Singular values below this share of the largest count as zero: a finger that is stretched cannot
follow exactly, and need not for a fraction of a millimetre."""

STEADY_TOL, MOST_LAPS = 2e-5, 10
"""The centres are led where tips roll to until that moves by no more than this (m), but no more
often than that. Fingers need two or three laps; a thumb with a joint to spare turns another way
each time, and slid by 0.5 mm between knots after two, by 0.2 after five."""


def lead(
    task: GraspTask, bases: Sequence[SE3], first: FloatArray, last: FloatArray
) -> list[FloatArray]:
    """Joints (nq,) at places between two knots, and at the knots themselves.

    Args:
        task: Hand, fingers and object.
        bases: Base in the object's frame at m places, evenly from the first knot to the last.
        first: Joints (nq,) at the first knot.
        last: Joints (nq,) at the last one.
    """
    moving = MovingHand(task.hand, first)
    shares = np.linspace(0.0, 1.0, len(bases))
    postures = [first + s * (last - first) for s in shares]
    ends = [_tips(task, moving, bases[k], postures[k])[0] for k in (0, -1)]
    straight = ends[0] + shares[:, None, None] * (ends[1] - ends[0])  # (m, n, 3)
    wanted = straight
    for _ in range(MOST_LAPS):
        postures = [
            first,
            *(
                _follow(task, moving, base, q, centers)
                for base, q, centers in zip(bases[1:-1], postures[1:-1], wanted[1:-1], strict=True)
            ),
            last,
        ]
        gone = _rolled(task, moving, bases, postures)
        before, wanted = wanted, straight + gone - shares[:, None, None] * gone[-1]
        if np.abs(wanted - before).max() <= STEADY_TOL:
            break
    return postures


def _tips(
    task: GraspTask, moving: MovingHand, base: SE3, q: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Centres (n, 3) of the pads and orientations (n, 3, 3) of the tips, object frame."""
    moving.move(q)
    poses = [base * moving.joint_pose(f.pad.joint_id) for f in task.fingers]
    centers = [pose.act(f.pad.center) for pose, f in zip(poses, task.fingers, strict=True)]
    return np.array(centers), np.array([pose.rotation for pose in poses])


def _rolled(
    task: GraspTask, moving: MovingHand, bases: Sequence[SE3], postures: Sequence[FloatArray]
) -> FloatArray:
    """How far (m, n, 3) the centres have come at each place if the tips roll."""
    tips = [_tips(task, moving, base, q) for base, q in zip(bases, postures, strict=True)]
    out = np.zeros((len(tips), len(task.fingers), 3))
    for k in range(1, len(tips)):
        (old, turned), (new, turns) = tips[k - 1], tips[k]
        normals = task.object.shape.closest_point((old + new) / 2)[1]
        for i, finger in enumerate(task.fingers):
            turn = pin.log3(turns[i] @ turned[i].T)
            out[k, i] = out[k - 1, i] + finger.pad.radius * np.cross(turn, normals[i])
    return out


def _follow(
    task: GraspTask, moving: MovingHand, base: SE3, q: FloatArray, centers: FloatArray
) -> FloatArray:
    """Joints (nq,) near q with the pads' centres above these (n, 3), one radius off the surface."""
    hand = task.hand
    points, outward = task.object.shape.closest_point(centers)
    radii = np.array([f.pad.radius for f in task.fingers])
    to_base = base.inverse()
    wanted = np.array([to_base.act(c) for c in points + radii[:, None] * outward])
    matrix, value = hand.coupling_matrix
    coupled = np.flatnonzero(np.abs(matrix).sum(axis=0))
    index = np.union1d(coupled, np.concatenate([f.q_index for f in task.fingers]))
    index = np.setdiff1d(index, hand.wrist_index).astype(np.int64)
    q = q.copy()
    for _ in range(STEPS):
        moving.move(q)
        now = np.array([moving.pad_center(f) for f in task.fingers])
        missing = np.concatenate([(wanted - now).ravel(), value - matrix @ q])
        if np.abs(missing).max() <= ARRIVED:
            break
        rows = [
            moving.point_jacobian(f.pad.joint_id, c)[:3]
            for f, c in zip(task.fingers, now, strict=True)
        ]
        step = np.linalg.lstsq(np.vstack([*rows, matrix])[:, index], missing, rcond=RCOND)[0]
        q[index] = np.clip(q[index] + step, hand.q_lower[index], hand.q_upper[index])
    return q
