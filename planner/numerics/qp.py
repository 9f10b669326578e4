"""``solve_qp``: small dense quadratic programmes, each once.

    min  x'P x / 2 + q'x    s.t.  low <= A x <= high,  lower <= x <= upper

DAQP (Arnström, Bemporad, Axehill, "A dual active-set solver for embedded quadratic programming
using recursive LDL' updates", 2022) solves those of this project to rounding in 20 to 300 us. It is
a dual method: its answer is the minimum if it is feasible, which is checked. A programme that is
solved again with other numbers keeps a ``planner.numerics.qp_workspace``.
"""

from __future__ import annotations

import math
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
