"""Projection of a solution onto the true surface of the object.

The solver's solution touches a model of the object (the smooth field of a mesh) with a model of the
pad (a sphere). Both are right to some tenths of a millimetre. Here the fingers' own joints are
moved by the least amount that brings every pad onto the true surface and closes the couplings,

    min |dq|  s.t.  n_i' J_i dq = -gap_i,   C dq = d - C q,   wrist and base as they are,

repeated until gaps and couplings are met (``planner.numerics.ik_step``).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from planner.collision.pad_contact import pad_contact_queries
from planner.numerics.ik_step import Task, ik_step
from planner.spatial import SE3, FloatArray, IntArray
from planner.task import GraspTask

__all__ = ["project_onto_surface"]

GAP_TOL = 2e-5
"""Gap (m) that counts as none: a twenty-fifth of what counts as touching."""

COUPLING_TOL = 1e-7
"""Violation of a coupling (rad) that counts as none: a tenth of what is allowed in the verdict."""

STEPS = 8
"""Most steps."""

FARTHEST = 0.006
"""Largest gap (m) that is still a matter of models; more than that is no solution."""


def project_onto_surface(task: GraspTask, T_world_base: SE3, q: FloatArray) -> FloatArray:
    """Joints (nq,) near q with every pad on the true surface, as far as limits let them.

    The verdict on it is ``planner.verification.geometry``'s; q itself if it touches already, or is
    too far off.
    """
    hand, touching = task.hand, pad_contact_queries(task)
    matrix, value = hand.coupling_matrix
    index = _moved(task)
    lower, upper = hand.q_lower[index], hand.q_upper[index]
    turn = T_world_base.rotation.T @ task.T_world_object.rotation
    q = q.copy()
    for _ in range(STEPS):
        found = touching.gaps(T_world_base, q)
        missing = value - matrix @ q
        worst = float(np.abs(found.gaps).max())
        arrived = worst <= GAP_TOL and float(np.abs(missing).max(initial=0.0)) <= COUPLING_TOL
        if arrived or worst > FARTHEST:
            break
        rates = np.einsum("ni,nij->nj", found.outward @ turn.T, found.jacobians)
        touch = Task(np.vstack([rates, matrix])[:, index], np.concatenate([-found.gaps, missing]))
        q[index] = ik_step(touch, q[index], lower, upper)
    return q


@lru_cache(maxsize=8)
def _moved(task: GraspTask) -> IntArray:
    """Joints (k,) that may move: the task's fingers, and what is coupled on fingers left out."""
    hand = task.hand
    coupled = np.flatnonzero(np.abs(hand.coupling_matrix[0]).sum(axis=0))
    held = np.concatenate([hand.wrist_index, hand.arm_index])
    mine = np.concatenate([f.q_index for f in task.fingers])
    found = np.union1d(mine, np.setdiff1d(coupled, held))
    found.flags.writeable = False
    return found
