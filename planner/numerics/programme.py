"""Small dense linear and quadratic programmes, by the hundred.

    min  x'H x / 2 + g'x    s.t.  low <= A x <= high,  lower <= x <= upper

DAQP (Arnström, Bemporad, Axehill, "A dual active-set solver for embedded quadratic programming
using recursive LDL' updates", 2022), which CasADi brings, solves the quadratic ones of this project
to rounding in 20 to 300 us. CasADi's call by arguments would add 0.25 ms of converting; through its
buffers it adds 10 us. What is said to be solved is checked to be allowed.

SciPy's HiGHS solves the linear ones, in 3 ms; DAQP tries first where duality tells whether it is
right (``planner.quality.closure``). CasADi's HiGHS takes 0.2 to 1 ms, but its library
bears the name of that of the package highspy, which qpsolvers loads where it is installed: of the
two the first that is loaded serves both, and the process dies. What else is installed must change
neither answers nor speed, so CasADi's is not used at all. Its CLP and CBC give wrong answers where
rows have one limit, and print; its qpOASES gives up on one programme in fifteen of certificates.
"""

from __future__ import annotations

import math
from typing import Any, Literal, Protocol

import numpy as np
from scipy.optimize import linprog

from planner.spatial import FloatArray
from planner.system.threads import BUILDING, kept_by_thread

__all__ = ["Programme", "ScipyProgramme", "programme"]

PROXIMAL = 1e-3
"""Weight (-) of the step in DAQP's proximal method, by which it solves linear programmes. Of 300
min-weight programmes 299 are solved to 1e-9 in 0.25 ms each; with 1e-4 to 2e-7, with 1e-6 212."""

_DAQP: dict[str, dict[str, Any]] = {
    "daqp": {"primal_tol": 1e-10},
    "proximal": {"primal_tol": 1e-10, "eps_prox": PROXIMAL},
}
"""DAQP's options for quadratic and for linear programmes."""

_HIGHS = {"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10}
"""HiGHS at its tightest."""

INFEASIBLE = 2
"""SciPy's status of a programme in which nothing is allowed."""

KEPT = 64
"""Solvers that a thread keeps, one for every size."""

FEASIBLE_TOL = 1e-8
"""Largest violation of a row or a bound, by the larger of the largest unknown and 1, of what counts
as a solution. DAQP is a dual method: what it gives is the minimum if it is allowed."""


class Programme(Protocol):
    """A solver for programmes of one size."""

    @property
    def row_prices(self) -> FloatArray:
        """After a solution: change of the least cost per unit of each row's limit, (m,)."""

    @property
    def bound_prices(self) -> FloatArray:
        """The same of the bounds, (n,): >= 0 at a lower, <= 0 at an upper bound."""

    def solve(self, **values: FloatArray) -> FloatArray | None:
        """The minimiser (n,), None where there is none.

        Args:
            **values: h (n, n), symmetric; g (n,); a (m, n); lba, uba (m,); lbx, ubx (n,).
        """


class _DaqpProgramme:
    """DAQP through CasADi's buffers."""

    def __init__(self, solver: Literal["daqp", "proximal"], n: int, m: int) -> None:
        """Make it for n unknowns and m rows; H is 0 where it is never given."""
        import casadi as ca  # loaded when the first programme is solved, not with the contacts

        with BUILDING:
            shapes = {"a": ca.Sparsity.dense(m, n), "h": ca.Sparsity.dense(n, n)}
            options: dict[str, Any] = {"error_on_fail": False, "daqp": _DAQP[solver]}
            self._solve = ca.conic("programme", "daqp", shapes, options)
        made: Any = self._solve.buffer()  # kept: the solver works in it
        self._buffer, self._run = made
        self._in = {
            name: np.zeros(self._solve.sparsity_in(name).nnz()) for name in self._solve.name_in()
        }
        for name, values in self._in.items():
            self._buffer.set_arg(self._solve.index_in(name), values.data)
        self._x, self._rows, self._bounds = np.zeros(n), np.zeros(m), np.zeros(n)
        outputs = {"x": self._x, "lam_a": self._rows, "lam_x": self._bounds}
        for name, values in outputs.items():
            self._buffer.set_res(self._solve.index_out(name), values.data)

    @property
    def row_prices(self) -> FloatArray:
        return -self._rows

    @property
    def bound_prices(self) -> FloatArray:
        return -self._bounds

    def solve(self, **values: FloatArray) -> FloatArray | None:
        if not _is_posed(values):
            return None
        for name, value in values.items():
            self._in[name][:] = value.ravel(order="F")
        self._x.fill(np.nan)
        self._run()
        x = self._x.copy()
        return x if _is_allowed(x, values) else None


class ScipyProgramme:
    """HiGHS through SciPy.

    Attributes:
        infeasible: After a failure: whether the solver says that nothing is allowed.
    """

    row_prices: FloatArray
    bound_prices: FloatArray
    infeasible = False

    def solve(self, **values: FloatArray) -> FloatArray | None:
        """As ``Programme.solve``."""
        self.infeasible = False
        if not _is_posed(values):
            return None
        a, low, high = values["a"], values["lba"], values["uba"]
        equal = low == high
        up, down = ~equal & np.isfinite(high), ~equal & np.isfinite(low)
        found = linprog(
            values["g"],
            A_eq=a[equal],
            b_eq=low[equal],
            A_ub=np.vstack([a[up], -a[down]]),
            b_ub=np.concatenate([high[up], -low[down]]),
            bounds=np.column_stack([values["lbx"], values["ubx"]]),
            method="highs-ds",
            options=_HIGHS,
        )
        self.infeasible = found.status == INFEASIBLE
        if found.status != 0 or not _is_allowed(found.x, values):
            return None
        self.row_prices = np.zeros(len(low))
        self.row_prices[equal] = found.eqlin.marginals
        of_upper, of_lower = np.split(found.ineqlin.marginals, [int(up.sum())])
        self.row_prices[up] += of_upper
        self.row_prices[down] -= of_lower
        self.bound_prices = found.lower.marginals + found.upper.marginals
        return np.asarray(found.x)


def _is_posed(values: dict[str, FloatArray]) -> bool:
    """Whether all is a number: DAQP does not end on NaN, and the others raise on NaN limits."""
    if not math.isfinite(sum(float(values[k].sum()) for k in ("h", "g", "a") if k in values)):
        return False
    return not any(np.isnan(values[k]).any() for k in ("lba", "uba", "lbx", "ubx"))


def _is_allowed(x: FloatArray, values: dict[str, FloatArray]) -> bool:
    """Whether rows and bounds are kept; not so where the buffer holds what is no solution."""
    size = max(1.0, float(np.abs(x).max()))
    for part, low, high in ((values["a"] @ x, "lba", "uba"), (x, "lbx", "ubx")):
        outside = np.maximum(values[low] - part, part - values[high])
        if not outside.max(initial=0.0) <= FEASIBLE_TOL * size:  # NaN too
            return False
    return True


@kept_by_thread(KEPT)
def programme(solver: Literal["daqp", "proximal", "highs"], n: int, m: int) -> Programme:
    """The solver for a size, of which every thread keeps its last few.

    "daqp" is for quadratic programmes, "highs" for linear ones. "proximal" is for linear ones whose
    answer the caller checks: a tenth of the time, and wrong now and then.

    Its answer holds until the thread asks for another of that size: ask for the solver where it is
    used, and read its prices at once.
    """
    return ScipyProgramme() if solver == "highs" else _DaqpProgramme(solver, n, m)
