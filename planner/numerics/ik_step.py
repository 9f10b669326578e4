"""One step of inverse kinematics by least squares, with limits and distances.

Tasks give the motion e of points or frames and its Jacobian J by the joints. With limits of the
joints alone ``ik_step`` solves

    min  |J dq - e|^2 + damping |dq|^2    s.t.  lower <= q + dq <= upper

in closed form with the joints that are stuck at a limit left out; with damping 0 it is the least
step that is best for the tasks. With distances to keep, ``constrained_ik_step`` solves a quadratic
programme. It does not replace the first: it is slower, and it needs damping for a unique solution,
which keeps couplings from being met to 1e-7 rad.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planner.numerics.qp import solve_qp
from planner.spatial import FloatArray


@dataclass(frozen=True)
class Task:
    """A desired motion of points or frames, in units in which all rows have the same weight.

    Attributes:
        jacobian: Its rates by the joints (m, n).
        error: The motion (m,).
    """

    jacobian: FloatArray
    error: FloatArray


@dataclass(frozen=True)
class Barrier:
    """Distances with a least growth in a step.

    Attributes:
        rates: Their rates by the joints (k, n).
        least: Least growth (k,); negative where they may shrink.
        unit: Unit of the slack by which the worst may miss its bound at a penalty.
    """

    rates: FloatArray
    least: FloatArray
    unit: float = 1.0


def ik_step(
    task: Task,
    q: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    *,
    damping: float = 0.0,
    rcond: float = 1e-6,
) -> FloatArray:
    """Joints (n,) within their limits after one step.

    Args:
        task: All tasks, one above the other.
        q: Joints now (n,), within their limits.
        lower: Least joints (n,).
        upper: Largest joints (n,).
        damping: Cost of a squared step against the squared error of a task.
        rcond: Without damping, singular values below this share of the largest count as zero.
    """
    free = np.ones(len(q), dtype=bool)
    new = q
    while free.any():
        new = q.copy()
        new[free] += _least_squares(task.jacobian[:, free], task.error, damping, rcond)
        beyond = free & ((new < lower) | (new > upper))
        new = np.clip(new, lower, upper)
        # a joint that moved to its limit has used its share; only one that was there already is
        # stuck
        stuck = beyond & (new == q)
        if not stuck.any():
            break
        free &= ~stuck
    return new


def constrained_ik_step(
    task: Task,
    barriers: Sequence[Barrier],
    lower: FloatArray,
    upper: FloatArray,
    *,
    equality: Task,
    posture: FloatArray,
    posture_weight: float,
    damping: float,
    price: float,
) -> FloatArray | None:
    """The step (n,) within its bounds that is best for the task, with soft barriers.

        min  |J dq - e|^2 + posture_weight |dq - posture|^2 + damping |dq|^2 + |s|^2 + 2 price s
        s.t. rates dq + unit s >= least for every barrier, with s >= 0 of its own
             equality; lower <= dq <= upper

    Args:
        task: All tasks, one above the other.
        barriers: Distances to keep.
        lower: Least step (n,).
        upper: Largest step (n,).
        equality: Met exactly: couplings of joints.
        posture: Step (n,) to the preferred posture.
        posture_weight: Cost of a squared deviation from it.
        damping: Cost of a squared step.
        price: Cost of missing a barrier by one unit: more than any task is worth.

    Returns:
        The step; None where the equalities and the bounds contradict each other.
    """
    n, k, m = len(lower), len(barriers), len(equality.error)
    counts = [len(b.least) for b in barriers]
    barrier, units = np.repeat(np.arange(k), counts), np.array([b.unit for b in barriers])
    rates = np.concatenate([np.zeros((0, n)), *(b.rates for b in barriers)])
    least = np.concatenate([np.zeros(0), *(b.least for b in barriers)])
    size = n + k  # the last unknowns: by how much barriers are missed
    hessian, gradient = np.zeros((size, size)), np.empty(size)
    hessian[:n, :n] = task.jacobian.T @ task.jacobian
    hessian[np.arange(n), np.arange(n)] += posture_weight + damping
    hessian[np.arange(n, size), np.arange(n, size)] = 1.0
    gradient[:n] = -(task.jacobian.T @ task.error + posture_weight * posture)
    gradient[n:] = price
    table = np.zeros((m + len(least), size))
    table[:m, :n], table[m:, :n] = equality.jacobian, rates
    table[m + np.arange(len(least)), n + barrier] = units[barrier]
    found = solve_qp(
        hessian,
        gradient,
        table,
        np.concatenate([equality.error, least]),
        np.concatenate([equality.error, np.full(len(least), np.inf)]),
        np.concatenate([lower, np.zeros(k)]),
        np.concatenate([upper, np.full(k, np.inf)]),
    )
    return None if found is None else found[:n]


def _least_squares(
    jacobian: FloatArray, error: FloatArray, damping: float, rcond: float
) -> FloatArray:
    """The step (n,) without limits."""
    if damping:
        gram = jacobian @ jacobian.T + damping * np.eye(len(error))
        return np.asarray(jacobian.T @ np.linalg.solve(gram, error))
    return np.asarray(np.linalg.lstsq(jacobian, error, rcond=rcond)[0])
