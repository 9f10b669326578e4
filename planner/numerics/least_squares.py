"""Least squares with bounds: Levenberg-Marquardt, and steps of inverse kinematics.

Residuals may count on one side of zero only:

    min |r_e(x)|^2 + |min(r_i(x), 0)|^2,   lower <= x <= upper

Damped Gauss-Newton steps, cut to the bounds; unknowns at a bound that are pushed against it stay.
Damping follows Nielsen (1999), Damping parameter in Marquardt's method. SciPy's least_squares is
much slower: its singular value decompositions and checks cost more than the residuals of a grasp.

Tasks of inverse kinematics give the motion e of points or frames and its Jacobian J by the joints.
With limits of the joints alone ``ik_step`` solves

    min  |J dq - e|^2 + damping |dq|^2    s.t.  lower <= q + dq <= upper

in closed form with the joints that are stuck at a limit left out; with damping 0 it is the least
step that is best for the tasks. With distances to keep, ``constrained_ik_step`` solves a quadratic
programme. It does not replace the first: it is slower, and it needs damping for a unique solution,
which keeps couplings from being met to 1e-7 rad.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from planner.numerics.qp import solve_qp
from planner.spatial import FloatArray, IntArray

MAX_ITERATIONS = 40
"""Evaluations of the residuals in one run."""

SOLVED = 0.05
"""Largest residual of a term that counts as solved, weighted."""

SLOW = 0.05
"""Share of the sum of squares below which the gain of a step ends a run that is solved."""

STALLED, PATIENCE = 1e-3, 3
"""So many steps in a row that each gain less than this share end a run that is not solved."""

FIRST_DAMPING = 1e-3
"""Damping of the first step over the largest diagonal entry of J'J."""

LEAST_GAIN = 1e-3
"""Share of the expected decrease that a step must bring."""


@dataclass(frozen=True, kw_only=True)
class LMResult:
    """Where a run ended.

    Attributes:
        x: Unknowns (n,).
        worst: Largest residual of a term, weighted.
        status: Why it ended.
        iterations: Evaluations of the residuals.
        damping: Damping of the next step; None before the first.
    """

    x: FloatArray
    worst: float
    status: str
    iterations: int
    damping: float | None


class StructuredJacobian(Protocol):
    """A Jacobian (m, n) that is kept in another way than as an array."""

    def normal_equations(self) -> tuple[FloatArray, FloatArray]:
        """J'J (n, n) and J'r (n,) with the residuals r (m,) that it came with."""


class ResidualFunction(Protocol):
    """The residuals to minimise.

    Attributes:
        n_terms: After a call: the first so many rows must vanish; the others are a cost.
    """

    n_terms: int

    def __call__(self, x: FloatArray) -> tuple[FloatArray, FloatArray | StructuredJacobian]:
        """The residuals r (m,) that count at x and their Jacobian (m, n).

        Those that count on one side of zero are left out on the other. Both arrays may be
        overwritten by the next call.
        """


def levenberg_marquardt(
    residuals: ResidualFunction,
    x: FloatArray,
    *,
    lower: FloatArray,
    upper: FloatArray,
    scale: FloatArray,
    max_iterations: int = MAX_ITERATIONS,
    damping: float | None = None,
    slow: float = SLOW,
    stalled: float = STALLED,
    patience: int = PATIENCE,
) -> LMResult:
    """Minimise from x. The last call of the residuals is at the x that is returned.

    Args:
        residuals: What is to vanish.
        x: Start (n,), within the bounds.
        lower: Least x (n,). Unknowns whose bounds are equal stay out of the equations.
        upper: Largest x (n,).
        scale: Typical steps (n,): damping treats them alike.
        max_iterations: Budget in evaluations.
        damping: Of the first step; None for ``FIRST_DAMPING``.
        slow: Share of the sum of squares below which a step's gain ends it when solved; infinite to
            end with the first step that solves the terms, whatever the cost.
        stalled: Share of the sum of squares below which a step stalls.
        patience: Stalled steps in a row that end it.
    """
    free = np.flatnonzero(upper > lower)
    scale, lower, upper = scale[free], lower[free], upper[free]
    x, last = x.copy(), x[free]

    def evaluate(at: FloatArray) -> tuple[FloatArray, FloatArray | StructuredJacobian, float]:
        x[free] = at
        r, jacobian = residuals(x)
        return r, jacobian, float(np.abs(r[: residuals.n_terms]).max(initial=0.0))

    r, jacobian, worst = evaluate(last)
    total = float(r @ r)
    growth, idle, iterations, status = 2.0, 0, 1, "out of iterations"
    accepted = True  # whether the last call was at ``last``
    while iterations < max_iterations:
        if total <= NOTHING:
            status = "solved"
            break
        normal, slope = _normal_equations(r, jacobian, free, scale)
        if damping is None:
            damping = FIRST_DAMPING * float(normal.diagonal().max())
        least, most = (lower - last) / scale, (upper - last) / scale
        accepted = False
        while iterations < max_iterations and growth <= MOST_GROWTH:
            step = _step(normal, slope, damping, least, most)
            expected = -float(2 * slope @ step + step @ normal @ step)
            to = np.clip(last + step * scale, lower, upper)
            r_to, jacobian, worst_to = evaluate(to)
            iterations += 1
            total_to = float(r_to @ r_to)
            gain = (total - total_to) / expected if expected > 0 else -1.0
            accepted = gain > LEAST_GAIN
            if accepted:
                break
            damping, growth = damping * growth, growth * 2.0
        if not accepted:
            status = "no step descends"
            break
        share = (total - total_to) / total
        last, r, total, worst = to, r_to, total_to, worst_to
        damping, growth = damping * max(1 / 3, 1 - (2 * min(gain, 1.0) - 1) ** 3), 2.0
        idle = idle + 1 if share < stalled else 0
        if worst < SOLVED and share < slow:
            status = "solved"
            break
        if idle >= patience:
            status = "stalled"
            break
    if not accepted:
        evaluate(last)
    return LMResult(x=x, worst=worst, status=status, iterations=iterations, damping=damping)


def _normal_equations(
    r: FloatArray, jacobian: FloatArray | StructuredJacobian, free: IntArray, scale: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """J'J (k, k) and J'r (k,) of the free unknowns, in units of their scale (k,)."""
    if isinstance(jacobian, np.ndarray):
        rows = jacobian[:, free] * scale
        return rows.T @ rows, r @ rows
    normal, slope = jacobian.normal_equations()
    normal = normal[free][:, free]
    normal *= scale
    normal *= scale[:, None]
    return normal, slope[free] * scale


MOST_GROWTH = 2.0**10
"""Growth of the damping after which no smaller step is tried."""


def _step(
    normal: FloatArray, slope: FloatArray, damping: float, least: FloatArray, most: FloatArray
) -> FloatArray:
    """Solution of (J'J + damping I) step = -J'r with least <= step <= most.

    Unknowns that would leave their bounds are put on them and the others solved for again. The
    matrix is positive definite, so Cholesky cannot fail.
    """
    from planner.system.scipy_parts import dposv  # here: SciPy loads slowly

    damped = normal.copy()
    damped.ravel()[:: len(damped) + 1] += damping
    step = np.zeros(len(slope))
    held = ((least >= 0) & (slope > 0)) | ((most <= 0) & (slope < 0))
    for _ in range(ROUNDS):
        if held.any():
            free = np.flatnonzero(~held)
            if not len(free):
                break
            mine = damped[free]
            target = -slope[free] - mine[:, held] @ step[held]
            _, step[free], _ = dposv(mine[:, free], target)
        else:
            _, step, _ = dposv(damped, -slope)
        beyond = (step < least) | (step > most)
        if not beyond.any():
            break
        step = np.clip(step, least, most)
        held |= beyond
    return step


ROUNDS = 4
"""Rounds that fix unknowns on their bounds in one step; after the last the step is clipped."""

NOTHING = 1e-18
"""Sum of squares below which it counts as zero."""


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
