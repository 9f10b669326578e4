"""Joints between two knots: the pads roll evenly from contact to contact over the object's surface.

With joints interpolated linearly the pads would leave the surface by up to a millimetre, and slide.
Here every pad's centre follows a path one radius off the object's surface, and the joints follow by
least-norm inverse-kinematics steps (``planner.numerics.ik_step``),

    min |dq|  s.t.  J_i dq = wanted_i - c_i,   C dq = d - C q.

The first path is linear from knot to knot. The distance that the tips roll along it
(``planner.motion.rolling``) gives the next path, until both agree: a fixed-point iteration with
Anderson mixing.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from planner.kinematics.state import MovingHand
from planner.numerics.ik_step import Task, ik_step
from planner.spatial import SE3, FloatArray, IntArray
from planner.task import GraspTask

STEPS = 6
"""Most inverse-kinematics steps at a sample."""

ARRIVED = 1e-6
"""Distance (m) of a pad from its target, and error of a coupling, that end the steps."""

RCOND = 1e-3
"""Singular values below this share of the largest count as zero: a stretched finger cannot follow
exactly."""

STEADY_TOL, MOST_LAPS = 2e-5, 10
"""Change of the path (m) that ends the iteration, and most iterations. Without Anderson mixing a
thumb with a redundant joint converges slowly, because it turns another way each time."""


def interpolate_rolling(
    task: GraspTask, bases: Sequence[SE3], first: FloatArray, last: FloatArray
) -> list[FloatArray]:
    """Joints (nq,) at m samples from one knot to the next, both knots included.

    Args:
        task: Hand, fingers and object.
        bases: Pose of the base in the object's frame at the m samples, equally spaced.
        first: Joints (nq,) at the first knot.
        last: Joints (nq,) at the last one.
    """
    moving, index = MovingHand(task.hand, first), _moved_joints(task)
    shares = np.linspace(0.0, 1.0, len(bases))
    postures = [first + s * (last - first) for s in shares]
    ends = [_tips(task, moving, bases[k], postures[k])[0] for k in (0, -1)]
    straight = ends[0] + shares[:, None, None] * (ends[1] - ends[0])  # (m, n, 3)
    wanted = straight
    last_rolled, last_miss = straight, np.zeros_like(straight)
    for _ in range(MOST_LAPS):
        postures = [
            first,
            *(
                _follow(task, moving, index, base, q, centers)
                for base, q, centers in zip(bases[1:-1], postures[1:-1], wanted[1:-1], strict=True)
            ),
            last,
        ]
        gone = _rolled(task, moving, bases, postures)
        rolled = straight + gone - shares[:, None, None] * gone[-1]
        miss = rolled - wanted
        if np.abs(miss).max() <= STEADY_TOL:
            break
        wanted, last_rolled, last_miss = _mixed(rolled, miss, last_rolled, last_miss), rolled, miss
    return postures


def _mixed(
    value: FloatArray, miss: FloatArray, last_value: FloatArray, last_miss: FloatArray
) -> FloatArray:
    """The next iterate of a fixed-point iteration (Anderson 1965, one step of memory).

    It mixes in the last value by the share that minimises the linearised residual.
    """
    change = (miss - last_miss).ravel()
    if not last_miss.any() or not change.any():
        return value
    share = float(miss.ravel() @ change) / float(change @ change)
    return value - share * (value - last_value)


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
    """Displacements (m, n, 3) of the centres since the first sample if the tips roll."""
    tips = [_tips(task, moving, base, q) for base, q in zip(bases, postures, strict=True)]
    centers, turned = np.array([c for c, _ in tips]), np.array([r for _, r in tips])
    middle = (centers[:-1] + centers[1:]) / 2
    normals = task.object.shape.closest_point(middle.reshape(-1, 3))[1].reshape(middle.shape)
    steps = turned[1:] @ turned[:-1].swapaxes(-1, -2)
    turns = np.array([pin.log3(r) for r in steps.reshape(-1, 3, 3)]).reshape(middle.shape)
    radii = np.array([f.pad.radius for f in task.fingers])
    out = np.zeros_like(centers)
    np.cumsum(radii[:, None] * np.cross(turns, normals), axis=0, out=out[1:])
    return out


def _moved_joints(task: GraspTask) -> IntArray:
    """Joints of the fingers in contact, and joints coupled to any other."""
    matrix, _ = task.hand.coupling_matrix
    coupled = np.flatnonzero(np.abs(matrix).sum(axis=0))
    index = np.union1d(coupled, np.concatenate([f.q_index for f in task.fingers]))
    return np.setdiff1d(index, task.hand.wrist_index).astype(np.int64)


def _follow(
    task: GraspTask,
    moving: MovingHand,
    index: IntArray,
    base: SE3,
    q: FloatArray,
    centers: FloatArray,
) -> FloatArray:
    """Joints (nq,) near q with the pads' centres over these (n, 3), one radius off the surface."""
    hand = task.hand
    points, outward = task.object.shape.closest_point(centers)
    radii = np.array([f.pad.radius for f in task.fingers])
    to_base = base.inverse()
    wanted = np.array([to_base.act(c) for c in points + radii[:, None] * outward])
    matrix, value = hand.coupling_matrix
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
        reach = Task(np.vstack([*rows, matrix])[:, index], missing)
        q[index] = ik_step(reach, q[index], hand.q_lower[index], hand.q_upper[index], rcond=RCOND)
    return q
