"""``solve_lp``: small dense linear programmes, with a proof of the answer.

    min  cost . x    s.t.  low <= A x <= high,  lower <= x <= upper

DAQP's proximal-point method solves most of them fast, and is sometimes wrong. Its answer counts
only with a proof: of a solution, multipliers that bound the cost from below by the same value (weak
duality); of infeasibility, such multipliers of the least violation of any row (Farkas' lemma).
Everything else goes to SciPy's HiGHS, which is slower. A programme that HiGHS leaves undecided is
scaled and asked again of both; then the answer is ``NOT_KNOWN``. Programmes of many unknowns x >= 0
and few rows are solved by their duals, which have few unknowns and many rows:

    max  b . y    s.t.  A'y <= cost,  y >= 0 of rows >= b,  y <= 0 of rows <= b.

CasADi's HiGHS is no choice: its library bears the name of that of the package highspy, which
qpsolvers loads where it is installed. Of the two the first that is loaded serves both, and the
process dies. CasADi's CLP and CBC give wrong answers where rows have one limit, and its qpOASES
gives up on one programme in fifteen of certificates.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from typing import Literal, TypeAlias

import numpy as np

from planner.errors import PlannerError
from planner.numerics.qp import run_daqp, violation
from planner.spatial import FloatArray

PROXIMAL = 1e-3
"""Weight (-) of the step in DAQP's proximal-point method. Of 300 min-weight programmes of random
contacts 299 are proven optimal with it, 298 with 0.1, 44 with DAQP's own choice."""

ITERATIONS = 1000
"""Iterations (-) before DAQP's turn ends: its own 10,000 take 90 ms where it does not
succeed. With 500, a certificate takes twice the time."""

_SETTINGS = {"eps_prox": PROXIMAL, "iter_limit": ITERATIONS}

GAP_TOL = 1e-9
"""Largest gap between the cost of an answer of DAQP and the bound that its multipliers prove, by
the larger of the cost and 1 (-)."""

ALLOWED_TOL = 1e-8
"""Largest violation of a row or a bound, by the larger of the largest unknown and 1 (-)."""

MISSED_TOL = 1e-7
"""Least violation of any row above which a programme is infeasible (-): ten times what a solution
may have."""

BEYOND = 1e6
"""A programme counts as infeasible where every feasible x would be larger than this (-)."""

BY_DUAL = 64
"""Unknowns above which the dual is solved instead (-): 50 us where the programme itself takes 4 ms,
with 236 unknowns and 5 rows (the proofs of ``planner.certify.robust``)."""

_HIGHS = {"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10}
"""HiGHS at its tightest."""

_OPTIMAL, _INFEASIBLE, _UNBOUNDED = 0, 2, 3
"""SciPy's status of a programme; every other one leaves it undecided."""

SCALINGS = 3
"""Rounds (-) in which rows and columns are divided by the roots of their largest entries."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LpSolution:
    """A solved linear programme.

    Attributes:
        value: Least cost.
        x: (n,), where it is reached.
        row_duals: (m,), change of the least cost per unit of each row's limit: >= 0 at a lower
            limit, <= 0 at an upper one.
        bound_duals: (n,), the same of the bounds.
    """

    value: float
    x: FloatArray
    row_duals: FloatArray
    bound_duals: FloatArray


class Undecided(Enum):
    """The answer that is none."""

    NOT_KNOWN = "not known"


NOT_KNOWN: Literal[Undecided.NOT_KNOWN] = Undecided.NOT_KNOWN
"""The answer where no solver proves anything."""

LpAnswer: TypeAlias = LpSolution | Literal[Undecided.NOT_KNOWN] | None
"""A solution, None for an infeasible programme, or ``NOT_KNOWN``."""


def solve_lp(
    cost: FloatArray, rows: FloatArray, row_limits: FloatArray, bounds: FloatArray
) -> LpAnswer:
    """Least cost . x with row limits on rows @ x and bounds on x.

    Args:
        cost: (n,).
        rows: A (m, n).
        row_limits: (m, 2), least and greatest; may be infinite, or equal.
        bounds: (n, 2), the same of x.

    Returns:
        The solution; None if the programme is infeasible, or has no unknowns (n = 0); ``NOT_KNOWN``
        if no solver decides it.

    Raises:
        PlannerError: There is no least cost, or a number is NaN.
    """
    if not len(cost):
        return None
    limits = np.concatenate([bounds, row_limits]).T.copy()
    if not math.isfinite(cost.sum() + rows.sum()) or np.isnan(limits).any():
        raise PlannerError("a linear programme holds NaN; give finite costs and rows")
    answer = _asked(cost, rows, limits, "highs-ds")
    if answer is NOT_KNOWN:
        row, column = _scales(rows)
        scaled = limits * np.concatenate([1.0 / column, row])
        answer = _asked(cost * column, row[:, None] * rows * column, scaled, "highs-ipm")
        if isinstance(answer, LpSolution):
            answer = LpSolution(
                value=answer.value,
                x=column * answer.x,
                row_duals=row * answer.row_duals,
                bound_duals=answer.bound_duals / column,
            )
    return answer


def _asked(cost: FloatArray, rows: FloatArray, limits: FloatArray, method: str) -> LpAnswer:
    """The answer of DAQP if it is proven, else that of HiGHS."""
    standard = len(cost) > BY_DUAL and _is_standard(limits, len(cost))
    if standard:
        found = _by_dual(cost, rows, limits)
    else:
        found = run_daqp(None, cost, rows, limits[0], limits[1], **_SETTINGS)
    proven = None if found is None else _proven(cost, rows, limits, found[0], found[1][len(cost) :])
    if proven is not None:
        return proven
    if (_is_infeasible if standard else _misses_rows)(cost, rows, limits):
        return None
    return _by_highs(cost, rows, limits, method)


def _scales(rows: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Factors of rows (m,) and columns (n,), after which the largest entry of each is near 1."""
    row, column = np.ones(len(rows)), np.ones(rows.shape[1])
    for _ in range(SCALINGS):
        size = np.abs(row[:, None] * rows * column)
        row /= _root(size.max(axis=1, initial=0.0))
        column /= _root(size.max(axis=0, initial=0.0))
    return row, column


def _root(most: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt(np.where(most > 0.0, most, 1.0)))


def _proven(
    cost: FloatArray, rows: FloatArray, limits: FloatArray, x: FloatArray, row_duals: FloatArray
) -> LpSolution | None:
    """The solution if x (n,) is feasible and multipliers (m,) prove it optimal."""
    if violation(x, rows, *limits) > ALLOWED_TOL * max(1.0, float(np.abs(x).max())):
        return None
    value, scale = float(cost @ x), max(1.0, float(np.abs(cost).max()))
    least, missed, row_duals, bound_duals = _weak_duality(cost, rows, limits, row_duals)
    if missed > GAP_TOL * scale or not value - least <= GAP_TOL * max(1.0, abs(value)):
        return None
    return LpSolution(value=value, x=x, row_duals=row_duals, bound_duals=bound_duals)


def _weak_duality(
    cost: FloatArray, rows: FloatArray, limits: FloatArray, row_duals: FloatArray
) -> tuple[float, float, FloatArray, FloatArray]:
    """What multipliers of rows (m,) prove: cost . x >= the first - the second times sum |x|.

    Returns:
        Both numbers, and the multipliers of rows (m,) and bounds (n,) that prove it.
    """
    n = len(cost)
    # a multiplier of a limit that is not there proves nothing; bounds take up what rows leave over
    (lower, low), (upper, high) = ((side[:n], side[n:]) for side in limits)
    row_ends = np.where(row_duals > 0.0, low, high)
    row_duals = np.where(np.isinf(row_ends), 0.0, row_duals)
    bound_duals = cost - row_duals @ rows
    ends = np.where(bound_duals > 0.0, lower, upper)
    absent = np.isinf(ends)
    missed = float(np.abs(bound_duals[absent]).max(initial=0.0))
    bound_duals[absent] = 0.0
    ends, row_ends = np.where(absent, 0.0, ends), np.where(row_duals == 0.0, 0.0, row_ends)
    return float(bound_duals @ ends + row_duals @ row_ends), missed, row_duals, bound_duals


def _is_standard(limits: FloatArray, n: int) -> bool:
    """Whether every x is >= 0 or free, and every row has one limit, or two that are equal."""
    (lower, low), (upper, high) = ((side[:n], side[n:]) for side in limits)
    one_sided = (low == high) | (np.isinf(low) != np.isinf(high))
    return bool(
        one_sided.all() and np.isinf(upper).all() and ((lower == 0) | (lower < -1e300)).all()
    )


def _dual_limits(limits: FloatArray, n: int, most: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Limits of [y; A'y] where A'y is at most ``most`` (n,)."""
    low, high = limits[:, n:]
    equal = low == high
    return (
        np.concatenate(
            [
                np.where(equal | np.isinf(low), -np.inf, 0.0),
                np.where(limits[0, :n] == 0, -np.inf, most),
            ]
        ),
        np.concatenate([np.where(equal | np.isinf(high), np.inf, 0.0), most]),
    )


def _by_dual(
    cost: FloatArray, rows: FloatArray, limits: FloatArray
) -> tuple[FloatArray, FloatArray] | None:
    """The minimiser (n,) and multipliers [(n,) unused; (m,)] by DAQP on the dual."""
    n, m = len(cost), len(rows)
    target = np.where(np.isinf(limits[0, n:]), limits[1, n:], limits[0, n:])
    least, most = _dual_limits(limits, n, cost)
    found = run_daqp(None, -target, rows.T, least, most, **_SETTINGS)
    if found is None:
        return None
    y, duals = found
    return -duals[m:], np.concatenate([cost, y])


def _is_infeasible(cost: FloatArray, rows: FloatArray, limits: FloatArray) -> bool:
    """Whether DAQP finds y with A'y <= 0 and b . y > 0 (Farkas), up to ``BEYOND``."""
    n, m = len(cost), len(rows)
    target = np.where(np.isinf(limits[0, n:]), limits[1, n:], limits[0, n:])
    least, most = _dual_limits(limits, n, np.zeros(n))
    least[:m], most[:m] = np.maximum(least[:m], -1.0), np.minimum(most[:m], 1.0)
    found = run_daqp(None, -target, rows.T, least, most, **_SETTINGS)
    if found is None:
        return False
    y = np.clip(found[0], least[:m], most[:m])
    missed = violation(y, rows.T, least, most)
    # sum |x| is at least target . y / missed for every x that keeps the rows
    return bool(target @ y > BEYOND * missed and target @ y > ALLOWED_TOL)


def _misses_rows(cost: FloatArray, rows: FloatArray, limits: FloatArray) -> bool:
    """Whether DAQP proves that every x up to ``BEYOND`` within the bounds misses a row by more.

    The least violation is itself a programme, t >= 0 beside x, which always has a solution.
    """
    n, m = len(cost), len(rows)
    low, high = limits[:, n:]
    both, free = (
        np.hstack([np.vstack([rows, rows]), np.repeat([[1.0], [-1.0]], m, 0)]),
        np.full(m, np.inf),
    )
    ends = np.array(
        [
            np.concatenate([limits[0, :n], [0.0], low, -free]),
            np.concatenate([limits[1, :n], [np.inf], free, high]),
        ]
    )
    least = np.append(np.zeros(n), 1.0)
    found = run_daqp(None, least, both, ends[0], ends[1], **_SETTINGS)
    if found is None:
        return False
    proven, missed, *_ = _weak_duality(least, both, ends, found[1][n + 1 :])
    return proven > max(MISSED_TOL, BEYOND * missed)


def _by_highs(cost: FloatArray, rows: FloatArray, limits: FloatArray, method: str) -> LpAnswer:
    """The answer of HiGHS by one of its methods."""
    from scipy.optimize import linprog  # here, since SciPy loads slowly

    n = len(cost)
    low, high = limits[:, n:]
    equal = low == high
    up, down = ~equal & np.isfinite(high), ~equal & np.isfinite(low)
    found = linprog(
        cost,
        A_eq=rows[equal],
        b_eq=low[equal],
        A_ub=np.vstack([rows[up], -rows[down]]),
        b_ub=np.concatenate([high[up], -low[down]]),
        bounds=limits[:, :n].T,
        method=method,
        options=_HIGHS,
    )
    if found.status == _INFEASIBLE:
        return None
    if found.status == _UNBOUNDED:
        raise PlannerError(
            "a linear programme has no least cost: it falls without end; bound its unknowns"
        )
    if found.status != _OPTIMAL:
        return NOT_KNOWN
    row_duals = np.zeros(len(rows))
    row_duals[equal] = found.eqlin.marginals
    of_upper, of_lower = np.split(found.ineqlin.marginals, [int(up.sum())])
    row_duals[up] += of_upper
    row_duals[down] -= of_lower
    bound_duals = np.asarray(found.lower.marginals + found.upper.marginals)
    x = np.asarray(found.x)
    return LpSolution(value=float(cost @ x), x=x, row_duals=row_duals, bound_duals=bound_duals)
