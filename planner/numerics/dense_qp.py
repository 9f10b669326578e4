"""``DenseQp``: a quadratic programme in arrays that are written in place, for warm-started solvers.

Size and pattern of zeros are fixed. A writer of P, q or A sets ``new_p``, ``new_q`` or ``new_a``,
and a solver (``planner.numerics.qp_workspace``) reads only those again; limits may change every
time.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from planner.spatial import FloatArray

if TYPE_CHECKING:
    import qpsolvers


class DenseQp:
    """min 1/2 x'Px + q'x  with  low <= A x <= high,  lower <= x <= upper; written in place.

    Attributes:
        p: P (n, n), symmetric, positive definite.
        q: (n,).
        a: A (m, n), a view of the last rows of ``table``.
        table: [1; A] (n + m, n), whose products with x the limits bound.
        limits: (2, n + m), least and greatest of the unknowns and, after them, of the rows.
        least, most: (n + m,), its two rows.
        lower, upper: (n,), views of the first part.
        low, high: (m,), views of the second part; equal for an equality.
        value: (n + m,), the unknowns and rows at which ``violation`` was last taken.
        equalities: How many of the first rows of A are always equalities.
        cones: (mc, n), blocks of rows [head; tail ...] with head >= |tail|; none unless written.
        cone_sizes: Rows of each block.
        new_p, new_q, new_a: What was written since a solver last read it.
    """

    def __init__(self, n: int, m: int, equalities: int) -> None:
        """A programme of n unknowns and m rows with P = 1, A = 0 and no limits."""
        self.p, self.q, self.table = np.eye(n), np.zeros(n), np.eye(n + m, n)
        self.a = self.table[n:]
        self.limits = np.empty((2, n + m))
        self.least, self.most = self.limits
        self.least.fill(-np.inf)
        self.most.fill(np.inf)
        self.lower, self.low = self.least[:n], self.least[n:]
        self.upper, self.high = self.most[:n], self.most[n:]
        self.equalities = equalities
        self.cones, self.cone_sizes = np.zeros((0, n)), tuple[int, ...]()
        self.new_p = self.new_q = self.new_a = True
        self.value, self._apart = np.zeros(n + m), np.zeros((2, n + m))
        self._under, self._over = self._apart

    def violation(self, x: FloatArray) -> float:
        """Largest violation of a row, a bound or a cone at x (n,); infinite for NaN."""
        np.dot(self.table, x, out=self.value)
        np.subtract(self.value, self.limits, out=self._apart)
        under = self._under[self._under.argmin()]  # NaN is less and greater than any number here
        over = self._over[self._over.argmax()]
        worst = float(over if over > -under or math.isnan(over) else -under)
        if self.cone_sizes:
            worst = max(worst, self._outside_cones(x))
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

    def without_equalities(self) -> DenseQp:
        """A copy without its first rows, the equalities."""
        k, n = self.equalities, len(self.q)
        other = DenseQp(n, len(self.a) - k, 0)
        other.p[:], other.q[:], other.a[:] = self.p, self.q, self.a[k:]
        other.limits[:] = np.delete(self.limits, slice(n, n + k), axis=1)
        other.cones, other.cone_sizes = self.cones, self.cone_sizes
        return other

    def to_qpsolvers(self, *, sparse: bool = False, unit: float = 1.0) -> qpsolvers.Problem:
        """The programme for qpsolvers, without cones: G = [A; -A] of the rows with such limits.

        Args:
            sparse: Whether matrices are scipy.sparse.csc_matrix.
            unit: Of the unknowns: its answer times this is the minimiser.
        """
        import qpsolvers  # here, since qpsolvers loads slowly
        from scipy.sparse import csc_matrix  # here, since SciPy loads slowly

        matrix = csc_matrix if sparse else np.asarray
        k = self.equalities
        low, high = self.low[k:], self.high[k:]
        up, down = np.isfinite(high), np.isfinite(low)
        return qpsolvers.Problem(
            P=matrix(self.p),
            q=self.q / unit,
            G=matrix(np.vstack([self.a[k:][up], -self.a[k:][down]])),
            h=np.concatenate([high[up], -low[down]]) / unit,
            A=matrix(self.a[:k]) if k else None,
            b=self.low[:k] / unit if k else None,
            lb=self.lower / unit,
            ub=self.upper / unit,
        )

    def _outside_cones(self, x: FloatArray) -> float:
        """Largest |tail| - head."""
        blocks = np.split(self.cones @ x, np.cumsum(self.cone_sizes)[:-1])
        return max(float(np.linalg.norm(b[1:]) - b[0]) for b in blocks)
