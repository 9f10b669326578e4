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

from planner.numerics.kernels import kernel
from planner.numerics.qp import solve_qp
from planner.spatial import FloatArray, IntArray

__all__ = ["Barrier", "Task", "constrained_ik_step", "ik_step"]


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
    n, k = len(lower), len(barriers)
    counts = [len(b.least) for b in barriers]
    programme = _programme(
        task.jacobian,
        task.error,
        np.concatenate([np.zeros((0, n)), *(b.rates for b in barriers)]),
        np.concatenate([np.zeros(0), *(b.least for b in barriers)]),
        np.repeat(np.arange(k), counts),
        np.array([b.unit for b in barriers], dtype=np.float64),
        equality.jacobian,
        equality.error,
        lower,
        upper,
        posture,
        (posture_weight, damping, price),
    )
    found = solve_qp(*programme)
    return None if found is None else found[:n]


Programme = tuple[
    FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray
]
"""Arguments of ``solve_qp``."""


def _programme_plain(
    jacobian: FloatArray,
    error: FloatArray,
    rates: FloatArray,
    least: FloatArray,
    barrier: IntArray,
    units: FloatArray,
    equal_rates: FloatArray,
    equal_error: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    posture: FloatArray,
    costs: tuple[float, float, float],
) -> Programme:
    """``_programme`` in NumPy."""
    posture_weight, damping, price = costs
    n, k, m = len(lower), len(units), len(equal_error)
    size = n + k  # the last unknowns: by how much barriers are missed
    hessian, gradient = np.zeros((size, size)), np.empty(size)
    hessian[:n, :n] = jacobian.T @ jacobian
    hessian[np.arange(n), np.arange(n)] += posture_weight + damping
    hessian[np.arange(n, size), np.arange(n, size)] = 1.0
    gradient[:n] = -(jacobian.T @ error + posture_weight * posture)
    gradient[n:] = price
    table = np.zeros((m + len(least), size))
    table[:m, :n], table[m:, :n] = equal_rates, rates
    table[m + np.arange(len(least)), n + barrier] = units[barrier]
    low = np.concatenate([equal_error, least])
    high = np.concatenate([equal_error, np.full(len(least), np.inf)])
    nothing, endless = np.zeros(k), np.full(k, np.inf)
    bounds = np.concatenate([lower, nothing]), np.concatenate([upper, endless])
    return hessian, gradient, table, low, high, *bounds


@kernel(_programme_plain)
def _programme(
    jacobian: FloatArray,
    error: FloatArray,
    rates: FloatArray,
    least: FloatArray,
    barrier: IntArray,
    units: FloatArray,
    equal_rates: FloatArray,
    equal_error: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    posture: FloatArray,
    costs: tuple[float, float, float],
) -> Programme:
    """The quadratic programme of ``constrained_ik_step``.

    Args:
        jacobian: Of the task (t, n).
        error: (t,).
        rates: Of all distances (r, n).
        least: Their least growth (r,).
        barrier: Which barrier each belongs to (r,).
        units: Of the barriers' slacks (k,).
        equal_rates: (m, n).
        equal_error: (m,).
        lower: (n,).
        upper: (n,).
        posture: (n,).
        costs: Posture weight, damping and price.
    """
    posture_weight, damping, price = costs
    n, k, m, r = len(lower), len(units), len(equal_error), len(least)
    hessian, gradient = np.zeros((n + k, n + k)), np.empty(n + k)
    table, low, high = np.zeros((m + r, n + k)), np.empty(m + r), np.empty(m + r)
    least_x, most_x = np.zeros(n + k), np.full(n + k, np.inf)
    for i in range(n):
        slope = posture_weight * posture[i]
        for t in range(len(error)):
            slope += jacobian[t, i] * error[t]
        gradient[i] = -slope
        for j in range(i + 1):
            total = 0.0
            for t in range(len(error)):
                total += jacobian[t, i] * jacobian[t, j]
            hessian[i, j] = hessian[j, i] = total
        hessian[i, i] += posture_weight + damping
        least_x[i], most_x[i] = lower[i], upper[i]
    for i in range(n, n + k):
        hessian[i, i], gradient[i] = 1.0, price
    for i in range(m):
        low[i] = high[i] = equal_error[i]
        for j in range(n):
            table[i, j] = equal_rates[i, j]
    for i in range(r):
        low[m + i], high[m + i] = least[i], np.inf
        for j in range(n):
            table[m + i, j] = rates[i, j]
        table[m + i, n + barrier[i]] = units[barrier[i]]
    return hessian, gradient, table, low, high, least_x, most_x


def _least_squares(
    jacobian: FloatArray, error: FloatArray, damping: float, rcond: float
) -> FloatArray:
    """The step (n,) without limits."""
    if damping:
        gram = jacobian @ jacobian.T + damping * np.eye(len(error))
        return np.asarray(jacobian.T @ np.linalg.solve(gram, error))
    return np.asarray(np.linalg.lstsq(jacobian, error, rcond=rcond)[0])
