"""The last step onto the true surface.

The NLP's solution touches a model of the object (the smooth field of a mesh) with a model of the
pad (a sphere). Both are right to some tenths of a millimetre. Here the fingers' own joints are
moved by the least amount that brings every pad onto the true surface,

    min |dq|  s.t.  n_i' J_i dq = -gap_i,   C dq = 0,   wrist and base as they are,

repeated until the gaps are gone. Joints stay within their limits.
"""

from __future__ import annotations

import numpy as np

from planner.kinematics import HandState
from planner.spatial import SE3, FloatArray
from planner.synthesis.touch import PadTouch, pad_touches
from planner.task import GraspTask

__all__ = ["settle"]

SETTLED = 2e-5
"""Gap (m) that counts as none: a twenty-fifth of what counts as touching."""

STEPS = 8
"""Most steps; two or three are usual."""

FARTHEST = 0.006
"""Largest gap (m) that is still a matter of models; more than that is no solution."""


def settle(task: GraspTask, T_world_base: SE3, q: FloatArray) -> FloatArray:
    """Joints (nq,) near q with every pad on the true surface, as far as limits let them.

    What is left is for ``planner.synthesis.verify`` to judge; q itself if it touches already, or is
    too far off.
    """
    hand = task.hand
    index = np.unique(np.concatenate([f.q_index for f in task.fingers]))
    matrix, value = hand.coupling_matrix
    q = q.copy()
    for _ in range(STEPS):
        touches = pad_touches(task, T_world_base, q)
        gaps = np.array([t.pad_gap for t in touches])
        if np.abs(gaps).max() <= SETTLED or np.abs(gaps).max() > FARTHEST:
            break
        rows = np.vstack([_rows(task, T_world_base, q, touches)[:, index], matrix[:, index]])
        wanted = np.concatenate([-gaps, value - matrix @ q])
        q[index] += np.linalg.lstsq(rows, wanted, rcond=RCOND)[0]
        q = np.clip(q, hand.q_lower, hand.q_upper)
    return q


RCOND = 1e-6
"""Singular values below this share of the largest count as zero (couplings may repeat)."""


def _rows(task: GraspTask, T_world_base: SE3, q: FloatArray, touches: list[PadTouch]) -> FloatArray:
    """Rate (n, nq) of every gap over the joints, m/rad."""
    state = HandState(task.hand, q)
    T_base_object = T_world_base.inverse() * task.T_world_object
    rows = []
    for finger, touch in zip(task.fingers, touches, strict=True):
        jacobian = state.point_jacobian(finger.pad.joint_id, T_base_object.act(touch.point))
        rows.append((T_base_object.rotation @ touch.outward) @ jacobian[:3])
    return np.array(rows)
