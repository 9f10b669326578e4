"""``Osqp``: OSQP with its solver kept, for answers in some twenty iterations.

OSQP's method (Stellato, Banjac, Goulart, Bemporad, Boyd, "OSQP: an operator splitting solver for
quadratic programs", 2020) comes near the answer quickly and nearer slowly. A step therefore asks
for a share of the forces, from the last answer, and lets OSQP solve the equations of the limits it
then takes for active ("polishing", section 4 there): that is exact if those are the right ones.
Residuals tell; if they are too large, the same goes on from there with a smaller share, until the
tolerance itself is asked for.

Rows are divided by their norms at first, which does for OSQP's own scaling; that would be made anew
with every new A. Entries that were always 0 are left out. What ``osqp.OSQP`` adds around its
compiled part (copies of settings and results in new objects, 20 us) is left out too.
"""

from __future__ import annotations

import math
from importlib import import_module
from typing import Any

import numpy as np
from scipy.sparse import csc_matrix

from planner.numerics.dense_qp import DenseQp, SolverBase
from planner.spatial import FloatArray

__all__ = ["Osqp"]

LOOSE = 0.05
"""Residual that is asked for first, as a share of the last forces' norm (-). On five fingers with
eight sides 0.01 takes as many iterations in the median and a quarter more in the mean."""

NARROWER = 0.03
"""Factor on that residual (-) where the limits it found were not the active ones."""

RHO = 1.0
"""Step of the multipliers of inequalities at first, by the mean of P's diagonal (-). Of 0.3, 0.5, 1
and 2 the one with the least iterations; OSQP adapts it where a programme takes fifty."""

CHECK_EVERY = 5
"""Iterations (-) between looks at the residuals; a look costs about one iteration."""

MAX_ITERATIONS = 4000
"""Iterations before it gives up (-): OSQP's own default."""

OPEN = 1e30
"""What OSQP takes for no limit (N)."""

SOLVED = 1
"""OSQP's status of an answer within its tolerance."""


class Osqp(SolverBase):
    """See the module; bounds are its first rows, as in ``DenseQp.table``."""

    def __init__(self, qp: DenseQp, tolerance: float) -> None:
        """For a programme, with residuals below ``tolerance``."""
        super().__init__(qp)
        self._tolerance = self._least = tolerance
        self._pattern = np.eye(*qp.table.shape, dtype=np.bool_)
        self._limits = np.zeros_like(qp.limits)
        self._low, self._high = self._limits
        self._ext = import_module("osqp").OSQP().ext
        self._balance = qp.low[: qp.equalities]
        self._solver: Any = None
        settings = self._settings = self._ext.OSQPSettings()
        self._ext.osqp_set_default_settings(settings)
        settings.eps_rel, settings.max_iter = 0.0, MAX_ITERATIONS
        settings.check_termination, settings.check_dualgap = CHECK_EVERY, 0
        settings.verbose, settings.scaling = 0, 0
        # without equalities there may be no active limit, of which polishing would print a line
        self._loose = LOOSE if qp.equalities else 0.0

    def solve(self) -> bool:
        """Solve; see the module."""
        self._write()
        solver, settings, tolerance = self._solver, self._settings, self._least
        # forces are of the size of the last ones, or else of the wrench
        sized = self._balance if self.x is self._no_x else self.x
        asked = max(tolerance, self._loose * math.sqrt(sized @ sized))
        self.iterations = 0
        while True:
            # within the tolerance there is nothing to polish, and one residual may grow by it
            settings.eps_abs, settings.polishing = asked, int(asked > tolerance)
            solver.update_settings(settings)
            solver.solve()
            info = solver.info
            self.iterations += info.iter
            if info.status_val != SOLVED:
                self._solver = None  # a certificate of infeasibility is no start for anything
                return self.nothing(str(info.status))
            if asked == tolerance or (info.prim_res <= tolerance and info.dual_res <= tolerance):
                break
            asked = max(tolerance, NARROWER * asked)
        solution, n = solver.solution, len(self.x)
        duals = solution.y * self._weights
        self.status = "solved"
        return self.answer(solution.x.copy(), duals[n:], duals[:n])

    def _write(self) -> None:
        """Tell OSQP of what is new."""
        qp = self.qp
        if self._solver is None or (qp.new_a and qp.table.take(self._outside).any()):
            self._set_up()
        else:
            self._scale_limits()
            q = qp.q if qp.new_q else None
            self._solver.update_data_vec(q=q, l=self._low, u=self._high)
            if qp.new_a or qp.new_p:
                p = qp.p.take(self._p_at) if qp.new_p else None
                a = self._values() if qp.new_a else None
                self._solver.update_data_mat(P_x=p, P_i=None, A_x=a, A_i=None)
        qp.new_p = qp.new_q = qp.new_a = False

    def _scale_limits(self) -> None:
        np.multiply(self.qp.limits, self._weights, out=self._limits)
        np.maximum(self._limits, -OPEN, out=self._limits)
        np.minimum(self._limits, OPEN, out=self._limits)

    def _values(self) -> FloatArray:
        """Entries of [1; A] in OSQP's order."""
        entries = self.qp.table.take(self._at, out=self._entries, mode="clip")
        entries *= self._entry_weights
        return entries

    def _set_up(self) -> None:
        """A new solver, for the entries that are not 0 now or were not before."""
        qp, ext = self.qp, self._ext
        m, n = qp.table.shape
        self._pattern |= qp.table != 0.0
        self._outside = np.flatnonzero(~self._pattern)
        norms = np.linalg.norm(qp.table, axis=1)
        self._weights = 1.0 / np.where(norms > 0.0, norms, 1.0)
        # residuals of rows that are divided by more than 1 are to be less by as much
        self._least = self._tolerance * min(1.0, float(self._weights.min()))
        rows, upper = csc_matrix(self._pattern), csc_matrix(np.triu(np.ones((n, n))))
        # where the entries of OSQP's columns are in our rows
        columns, p_columns = (np.repeat(np.arange(n), np.diff(c.indptr)) for c in (rows, upper))
        self._at, self._p_at = rows.indices * n + columns, upper.indices * n + p_columns
        self._entries, self._entry_weights = np.zeros(len(columns)), self._weights[rows.indices]
        self._scale_limits()
        table = csc_matrix((self._values(), rows.indices, rows.indptr), shape=(m, n))
        cost = csc_matrix((qp.p.take(self._p_at), upper.indices, upper.indptr))
        self._settings.eps_abs = self._least
        self._settings.rho = RHO * float(qp.p.trace()) / n
        self._solver = ext.OSQPSolver(
            ext.CSC(cost), qp.q, ext.CSC(table), self._low, self._high, m, n, self._settings
        )
