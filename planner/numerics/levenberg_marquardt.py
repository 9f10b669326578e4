"""Levenberg-Marquardt with bounds, and with residuals that count on one side of zero.

    min |r_e(x)|^2 + |min(r_i(x), 0)|^2,   lower <= x <= upper

Damped Gauss-Newton steps, cut to the bounds; unknowns at a bound that are pushed against it stay.
Damping follows Nielsen (1999), Damping parameter in Marquardt's method. SciPy's least_squares is
much slower: its singular value decompositions and checks cost more than the residuals of a grasp.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

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
