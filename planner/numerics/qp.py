"""Small dense quadratic programmes, each once, and the steps of inverse kinematics made of them.

    min  x'P x / 2 + q'x    s.t.  low <= A x <= high,  lower <= x <= upper

DAQP (Arnström, Bemporad, Axehill, "A dual active-set solver for embedded quadratic programming
using recursive LDL' updates", 2022) solves those of this project to rounding in 20 to 300 us. It is
a dual method: its answer is the minimum if it is feasible, which is checked. A programme that is
solved again with other numbers keeps a ``planner.numerics.qp_workspace``.

Tasks of inverse kinematics give the motion e of points or frames and its Jacobian J by the joints.
With limits of the joints alone ``ik_step`` solves

    min  |J dq - e|^2 + damping |dq|^2    s.t.  lower <= q + dq <= upper

in closed form with the joints that are stuck at a limit left out; with damping 0 it is the least
step that is best for the tasks. With distances to keep, ``constrained_ik_step`` solves a quadratic
programme. It does not replace the first: it is slower, and it needs damping for a unique solution,
which keeps couplings from being met to 1e-7 rad.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import daqp
import numpy as np

from planner.spatial import FloatArray

ALLOWED_TOL = 1e-8
"""Largest violation (-) of a row or a bound by a solution, over the larger of its largest unknown
and 1."""

_PRIMAL_TOL = 1e-10
"""DAQP's own largest violation (-)."""

_EQUALITY = 5
"""DAQP's mark of a limit that is an equality."""


def solve_qp(
    p: FloatArray,
    q: FloatArray,
    a: FloatArray,
    low: FloatArray,
    high: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
) -> FloatArray | None:
    """The minimiser (n,), None where there is none.

    Args:
        p: P (n, n), symmetric, positive definite.
        q: (n,).
        a: A (m, n).
        low: Least values of A x (m,); minus infinity where free.
        high: Greatest values of A x (m,); equal to ``low`` for an equality.
        lower: Least values of x (n,).
        upper: Greatest values of x (n,).
    """
    least, most = np.concatenate([lower, low]), np.concatenate([upper, high])
    total = float(p.sum() + q.sum() + a.sum())
    if not math.isfinite(total) or np.isnan(least).any() or np.isnan(most).any():
        return None  # DAQP does not end on NaN
    found = run_daqp(p, q, a, least, most)
    if found is None:
        return None
    x, _ = found
    allowed = violation(x, a, least, most) <= ALLOWED_TOL * max(1.0, float(np.abs(x).max()))
    return x if allowed else None


def run_daqp(
    p: FloatArray | None,
    q: FloatArray,
    a: FloatArray,
    least: FloatArray,
    most: FloatArray,
    **settings: float,
) -> tuple[FloatArray, FloatArray] | None:
    """DAQP's solution: x (n,) and its multipliers (n + m,); None if it claims none.

    Args:
        p: P (n, n), or None for a linear programme.
        q: (n,).
        a: A (m, n).
        least: (n + m,), of bounds and rows.
        most: (n + m,), the same.
        **settings: DAQP's.

    Returns:
        Multipliers are changes of the least cost per unit of the limit: >= 0 at lower limits.
    """
    n = len(q)
    hessian = np.zeros((n, n)) if p is None else np.ascontiguousarray(p, dtype=np.float64)
    sense = np.where(least == most, _EQUALITY, 0).astype(np.int32)
    options: dict[str, Any] = {"primal_tol": _PRIMAL_TOL, **settings}
    table = np.ascontiguousarray(a, dtype=np.float64)
    gradient = np.ascontiguousarray(q, dtype=np.float64)
    x, _, flag, info = daqp.solve(hessian, gradient, table, most, least, sense, **options)
    return (x, -info["lam"]) if flag > 0 else None


def violation(x: FloatArray, a: FloatArray, least: FloatArray, most: FloatArray) -> float:
    """Largest violation of a bound or row (n + m,) at x (n,), at least 0; infinite for NaN."""
    value = np.concatenate([x, a @ x])
    worst = float(np.maximum(least - value, value - most).max(initial=0.0))
    return worst if math.isfinite(worst) else math.inf


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
