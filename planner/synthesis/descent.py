"""Levenberg and Marquardt's method with bounds, and with residuals that count on one side of zero.

    min |r_e(x)|^2 + |min(r_i(x), 0)|^2,   lower <= x <= upper

Damped Gauss-Newton steps, cut to the bounds; unknowns at a bound that are pushed against it stay.
Damping follows Nielsen (1999), Damping parameter in Marquardt's method. scipy's least_squares does
the same in ten times as long: its steps by singular values and its checks cost more than the
residuals of a grasp.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dposv

from planner.spatial import FloatArray

__all__ = ["Descent", "descend"]

MAX_ITERATIONS = 40
"""Evaluations of the residuals in one descent."""

SOLVED = 0.05
"""Largest residual of a term with which a descent is content, in weighted units."""

SLOW = 0.05
"""Share of the sum of squares below which a step's gain is not worth another one when solved."""

STALLED, PATIENCE = 1e-3, 3
"""Steps in a row (number) that gain less than this share end a descent that is not solved."""

FIRST_DAMPING = 1e-3
"""Damping of the first step over the largest diagonal entry of J'J."""

LEAST_GAIN = 1e-3
"""Share of the expected decrease that a step must bring."""


@dataclass(frozen=True, kw_only=True)
class Descent:
    """Where a descent ended.

    Attributes:
        x: Unknowns (n,).
        worst: Largest residual of a term, weighted.
        status: Why it ended.
        iterations: Evaluations of the residuals.
    """

    x: FloatArray
    worst: float
    status: str
    iterations: int


def descend(
    residuals: Callable[[FloatArray], tuple[FloatArray, FloatArray]],
    x: FloatArray,
    *,
    lower: FloatArray,
    upper: FloatArray,
    scale: FloatArray,
    equality: NDArray[np.bool_],
    n_terms: int,
    max_iterations: int = MAX_ITERATIONS,
) -> Descent:
    """Descend from x.

    Args:
        residuals: r (m,) and its Jacobian (m, n) at x; both may be overwritten by the next call.
            The last call is at the x that is returned.
        x: Start (n,), within the bounds.
        lower: Least x (n,).
        upper: Largest x (n,).
        scale: Typical steps (n,): damping treats them alike.
        equality: (m,), whether a residual counts on both sides of zero.
        n_terms: The first so many residuals must vanish; the others are a cost.
        max_iterations: Budget in evaluations.
    """

    def look(at: FloatArray) -> tuple[FloatArray, FloatArray]:
        values, jacobian = residuals(at)
        return np.where(equality, values, np.minimum(values, 0.0)), jacobian

    r, jacobian = look(x)
    total, worst = float(r @ r), _worst(r, n_terms)
    damping, growth, idle, iterations, status = -1.0, 2.0, 0, 1, "out of iterations"
    while iterations < max_iterations:
        if total <= NOTHING:
            status = "solved"
            break
        counts = np.flatnonzero(equality | (r != 0.0))
        rows = jacobian[counts] * scale
        slope, normal = rows.T @ r[counts], rows.T @ rows
        if damping < 0:
            damping = FIRST_DAMPING * float(normal.diagonal().max())
        least, most = (lower - x) / scale, (upper - x) / scale
        accepted = False
        while iterations < max_iterations and growth <= MOST_GROWTH:
            step = _step(normal, slope, damping, least, most)
            expected = -float(2 * slope @ step + step @ normal @ step)
            to = np.clip(x + step * scale, lower, upper)
            r_to, jacobian = look(to)
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
        x, r, total, worst = to, r_to, total_to, _worst(r_to, n_terms)
        damping, growth = damping * max(1 / 3, 1 - (2 * min(gain, 1.0) - 1) ** 3), 2.0
        idle = idle + 1 if share < STALLED else 0
        if worst < SOLVED and share < SLOW:
            status = "solved"
            break
        if idle >= PATIENCE:
            status = "stalled"
            break
    look(x)
    return Descent(x=x, worst=worst, status=status, iterations=iterations)


MOST_GROWTH = 2.0**10
"""Growth of the damping after which no smaller step is tried."""


def _worst(r: FloatArray, n_terms: int) -> float:
    return float(np.abs(r[:n_terms]).max(initial=0.0))


def _step(
    normal: FloatArray, slope: FloatArray, damping: float, least: FloatArray, most: FloatArray
) -> FloatArray:
    """Solution of (J'J + damping I) step = -J'r with least <= step <= most.

    Unknowns that would leave their bounds are put on them and the others solved for again. The
    matrix is positive definite, so Cholesky cannot fail.
    """
    damped = normal.copy()
    damped.ravel()[:: len(damped) + 1] += damping
    step = np.zeros(len(slope))
    held = ((least >= 0) & (slope > 0)) | ((most <= 0) & (slope < 0))
    for _ in range(ROUNDS):
        free = np.flatnonzero(~held)
        if not len(free):
            break
        target = -slope[free] - damped[np.ix_(free, np.flatnonzero(held))] @ step[held]
        _, step[free], _ = dposv(damped[np.ix_(free, free)], target)
        beyond = (step < least) | (step > most)
        if not beyond.any():
            break
        step = np.clip(step, least, most)
        held |= beyond
    return step


ROUNDS = 4
"""Rounds in which unknowns are put on their bounds in one step; the last ones are cut."""

NOTHING = 1e-18
"""Sum of squares that is zero."""
