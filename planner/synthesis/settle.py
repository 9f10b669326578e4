"""The last step onto the true surface.

The NLP's solution touches a model of the object (the smooth field of a mesh) with a model of the
pad (a sphere). Both are right to some tenths of a millimetre. Here the fingers' own joints are
moved by the least amount that brings every pad onto the true surface and closes the couplings,

    min |dq|  s.t.  n_i' J_i dq = -gap_i,   C dq = d - C q,   wrist and base as they are,

repeated until gaps and couplings are met. A joint that would leave its range stays at its end, and
the others do its share. Where links are then a little in each other or in the object, which the
models did not show either, their distances are further rows, with ``APART`` to be reached.
"""

from __future__ import annotations

import numpy as np

from planner.collision import CollisionWorld
from planner.spatial import SE3, FloatArray, IntArray
from planner.synthesis.touch import touching_of
from planner.task import GraspTask

__all__ = ["settle"]

SETTLED = 2e-5
"""Gap (m) that counts as none: a twenty-fifth of what counts as touching."""

COUPLED = 1e-7
"""Violation of a coupling (rad) that counts as none: a tenth of what is allowed in the verdict."""

STEPS = 8
"""Most steps; two or three are usual."""

APART = 2e-4
"""Distance (m) to which links are brought apart that are in each other, or in the object."""

LOOKS = 2
"""How often settled fingers are looked at for that."""

FARTHEST = 0.006
"""Largest gap (m) that is still a matter of models; more than that is no solution."""


def settle(
    task: GraspTask, T_world_base: SE3, q: FloatArray, world: CollisionWorld | None = None
) -> FloatArray:
    """Joints (nq,) near q with every pad on the true surface, as far as limits let them.

    What is left is for ``planner.synthesis.verify`` to judge; q itself if it touches already, or is
    too far off.

    Args:
        task: The task.
        T_world_base: Base pose.
        q: Joints (nq,).
        world: True geometry of the task; without it nothing but pads and couplings is looked at.
    """
    hand, touching = task.hand, touching_of(task)
    matrix, value = hand.coupling_matrix
    index = _moved(task, matrix)
    lower, upper = hand.q_lower[index], hand.q_upper[index]
    turn = T_world_base.rotation.T @ task.T_world_object.rotation
    q, looks = q.copy(), 0
    apart, base = np.zeros((0, hand.nq)), np.zeros(0)
    for _ in range(STEPS):
        found = touching.gaps(T_world_base, q)
        missing, short = value - matrix @ q, base - apart @ q
        worst = np.abs(found.gaps).max()
        if worst > FARTHEST:
            break
        if worst <= SETTLED and np.abs(missing).max(initial=0.0) <= COUPLED:
            if world is None or looks == LOOKS:
                break
            apart, base = _apart(world, T_world_base, q)
            short, looks = base - apart @ q, looks + 1
            if not len(short):
                break
        rates = np.einsum("ni,nij->nj", found.outward @ turn.T, found.jacobians)
        rows = np.vstack([rates, matrix, apart[short > 0.0]])[:, index]
        wanted = np.concatenate([-found.gaps, missing, short[short > 0.0]])
        q[index] = _step(rows, wanted, q[index], lower, upper)
    return q


def _apart(
    world: CollisionWorld, T_world_base: SE3, q: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Rows (k, nq) and least values of rows @ q (k,) that keep apart what is less than that."""
    near = world.near(T_world_base, q, APART, touching=touching_of(world.task).names)
    if not (near.distances < 0.0).any():
        return np.zeros((0, len(q))), np.zeros(0)
    state = world.moving.move(q)
    rows = state.point_rates(near.joints[:, 1], near.points_b, near.normals)
    rows -= state.point_rates(near.joints[:, 0], near.points_a, near.normals)
    return rows, APART - near.distances + rows @ q


def _moved(task: GraspTask, matrix: FloatArray) -> IntArray:
    """Joints (k,) that may move: the task's fingers, and what is coupled on fingers left out."""
    coupled = np.flatnonzero(np.abs(matrix).sum(axis=0))
    carried = np.concatenate([task.hand.wrist_index, task.hand.arm_index])
    mine = np.concatenate([f.q_index for f in task.fingers])
    return np.union1d(mine, np.setdiff1d(coupled, carried))


def _step(
    rows: FloatArray, wanted: FloatArray, q: FloatArray, lower: FloatArray, upper: FloatArray
) -> FloatArray:
    """Joints (k,) within their range after the least step dq from q with rows @ dq = wanted."""
    free = np.ones(len(q), dtype=bool)
    while True:
        step = np.zeros(len(q))
        step[free] = np.linalg.lstsq(rows[:, free], wanted, rcond=RCOND)[0]
        beyond = free & (((q + step < lower) & (q <= lower)) | ((q + step > upper) & (q >= upper)))
        if not beyond.any():
            return np.clip(q + step, lower, upper)
        free &= ~beyond


RCOND = 1e-6
"""Singular values below this share of the largest count as zero (couplings may repeat)."""
