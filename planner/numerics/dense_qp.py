"""``DenseQp``: a quadratic programme in arrays that are written in place; what keeps a solver.

One size and one pattern of zeros. Whoever writes P, q or A says so (``new_p``, ``new_q``,
``new_a``), so that a solver that is kept (``planner.numerics.warm_started``) is told of no more
than that; limits may change every time.
"""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from planner.spatial import FloatArray

__all__ = ["DenseQp", "KeptSolver", "SolverBase"]


class DenseQp:
    """min 1/2 x'Px + q'x  with  low <= A x <= high,  lower <= x <= upper; written in place.

    Attributes:
        p: P (n, n), symmetric, positive definite.
        q: (n,).
        a: A (m, n), a view of the last rows of ``table``.
        table: [1; A] (n + m, n), what all limits are about.
        limits: (2, n + m), least and greatest of the unknowns and, after them, of the rows.
        least, most: (n + m,), its two rows.
        lower, upper: (n,), views of the first part.
        low, high: (m,), views of the second part; equal for an equality.
        value: (n + m,), the unknowns and rows at which ``violation`` was last taken.
        equalities: How many of the first rows of A are always equalities.
        pattern: (m, n), where A may ever differ from 0.
        new_p, new_q, new_a: What was written since a solver last read it.
    """

    def __init__(self, pattern: NDArray[np.bool_], equalities: int) -> None:
        """A programme with P = 1, A = 0 and no limits."""
        m, n = pattern.shape
        self.p, self.q, self.table = np.eye(n), np.zeros(n), np.eye(n + m, n)
        self.a = self.table[n:]
        self.limits = np.tile([[-np.inf], [np.inf]], n + m)
        self.least, self.most = self.limits
        self.lower, self.low = self.least[:n], self.least[n:]
        self.upper, self.high = self.most[:n], self.most[n:]
        self.equalities, self.pattern = equalities, pattern
        self.new_p = self.new_q = self.new_a = True
        self.value, self._apart = np.zeros(n + m), np.zeros((2, n + m))
        self._under, self._over = self._apart

    def violation(self, x: FloatArray) -> float:
        """Largest violation of a row or a bound at x (n,); infinite for NaN."""
        np.dot(self.table, x, out=self.value)
        np.subtract(self.value, self.limits, out=self._apart)
        under = self._under[self._under.argmin()]  # NaN is less and greater than any number here
        over = self._over[self._over.argmax()]
        worst = float(over if over > -under or math.isnan(over) else -under)
        return max(worst, 0.0) if math.isfinite(worst) else math.inf

    def dual_residual(self, x: FloatArray, duals: FloatArray) -> float:
        """Largest entry of P x + q + A'y + z, or multiplier of a limit that is not there; or NaN.

        Args:
            x: (n,).
            duals: (m + n,), of rows and bounds: >= 0 at an upper, <= 0 at a lower limit.
        """
        m = len(self.a)
        rows, bounds = duals[:m], duals[m:]
        slope = self.p @ x + self.q + rows @ self.a + bounds
        ordered = np.concatenate([bounds, rows])
        wrong_up = np.where(np.isfinite(self.most), 0.0, np.maximum(ordered, 0.0))
        wrong_down = np.where(np.isfinite(self.least), 0.0, np.maximum(-ordered, 0.0))
        return float(np.max([np.abs(slope).max(), wrong_up.max(), wrong_down.max()]))


class KeptSolver(Protocol):
    """A solver made for one ``DenseQp``; the next call sees what was written meanwhile."""

    x: FloatArray
    """The last answer (n,), NaN where there is none; another array after the next call."""
    iterations: int
    """Iterations of the last call, -1 where the solver does not say."""
    status: str
    """What it said (informative only)."""

    @property
    def duals(self) -> FloatArray:
        """Multipliers (m + n,) of rows and bounds: P x + q + A'y + z = 0, >= 0 at upper limits."""

    def solve(self) -> bool:
        """Solve what the programme holds now; whether the solver claims an answer."""


class SolverBase:
    """What kept solvers have in common: where the answer goes."""

    def __init__(self, qp: DenseQp) -> None:
        """For one programme, which is kept, not copied."""
        self.qp = qp
        m, n = qp.a.shape
        self._no_x, self._no_duals = np.full(n, np.nan), np.full(m + n, np.nan)
        self.x = self._no_x
        self._bounds, self._rows = self._no_duals[m:], self._no_duals[:m]
        self.iterations, self.status = -1, ""

    @property
    def duals(self) -> FloatArray:
        """Multipliers (m + n,) of rows and bounds, put together when they are asked for."""
        return np.concatenate([self._rows, self._bounds])

    def answer(self, x: FloatArray, rows: FloatArray, bounds: FloatArray) -> bool:
        """Keep an answer (n,) and the multipliers of rows (m,) and bounds (n,); True."""
        self.x, self._rows, self._bounds = x, rows, bounds
        return True

    def nothing(self, status: str) -> bool:
        """There is no answer; False."""
        m = len(self.qp.a)
        self.x, self._rows, self._bounds = self._no_x, self._no_duals[:m], self._no_duals[m:]
        self.status = status
        return False
