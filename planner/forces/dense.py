"""Solvers kept alive between quadratic programmes of one size and one pattern of zeros.

``DenseQp`` is the programme in arrays that are written in place, ``keep_solver`` makes a solver
object that reads them again and again. DAQP, OSQP, ProxQP and PIQP are told of the change and start
from their last answer; any other solver that qpsolvers finds is called anew every time.
"""

from __future__ import annotations

import math
import warnings
from importlib import import_module
from importlib.util import find_spec
from typing import Any, Protocol

import numpy as np
import qpsolvers
from numpy.typing import NDArray
from scipy.sparse import csc_matrix

from planner.errors import NotFoundError
from planner.programme import Programme
from planner.spatial import FloatArray

__all__ = ["QUICK_SOLVER", "DenseQp", "KeptSolver", "keep_solver", "solver_names"]

QUICK_SOLVER = "daqp"
"""The solver that is always there: CasADi brings it. The package ``daqp``, where it is installed,
keeps its workspace and is quicker."""

MAX_ITERATIONS = 4000
"""Iterations of the first-order methods before they give up (-): OSQP's own default."""

_DAQP_EQUALITY = 5
"""DAQP's mark of a row that is an equality."""

_OSQP_SOLVED = 1
"""OSQP's status of an answer within its tolerance."""


class DenseQp:
    """min 1/2 x'Px + q'x  with  low <= A x <= high,  lower <= x <= upper; written in place.

    Attributes:
        p: P (n, n), symmetric, positive definite.
        q: (n,).
        a: A (m, n).
        limits: (2, n + m), least and greatest of the unknowns and, after them, of the rows.
        least, most: (n + m,), its two rows.
        lower, upper: (n,), views of the first part.
        low, high: (m,), views of the second part; equal for an equality.
        value: (n + m,), the unknowns and rows at which ``violation`` was last taken.
        equalities: How many of the first rows of A are always equalities.
        pattern: (m, n), where A may ever differ from 0.
    """

    def __init__(self, pattern: NDArray[np.bool_], equalities: int) -> None:
        """A programme with P = 1, A = 0 and no limits."""
        m, n = pattern.shape
        self.p, self.q, self.a = np.eye(n), np.zeros(n), np.zeros((m, n))
        self.limits = np.tile([[-np.inf], [np.inf]], n + m)
        self.least, self.most = self.limits
        self.lower, self.low = self.least[:n], self.least[n:]
        self.upper, self.high = self.most[:n], self.most[n:]
        self.equalities, self.pattern = equalities, pattern
        self.value, self._apart = np.zeros(n + m), np.zeros((2, n + m))

    def violation(self, x: FloatArray) -> float:
        """Largest violation of a row or a bound at x (n,); infinite for NaN."""
        n = len(x)
        self.value[:n] = x
        np.dot(self.a, x, out=self.value[n:])
        np.subtract(self.value, self.limits, out=self._apart)
        under, over = self._apart
        worst = max(-float(np.minimum.reduce(under)), float(np.maximum.reduce(over)), 0.0)
        return worst if math.isfinite(worst) else math.inf

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
    """The last answer (n,), NaN where there is none."""
    duals: FloatArray
    """Multipliers (m + n,) of rows and bounds: P x + q + A'y + z = 0, >= 0 at an upper limit."""
    iterations: int
    """Iterations of the last call, -1 where the solver does not say."""
    status: str
    """What it said (informative only)."""

    def solve(self) -> bool:
        """Solve what the programme holds now; whether the solver claims an answer."""


def solver_names() -> tuple[str, ...]:
    """Solvers that can be named, the quick one first."""
    others = sorted(set(qpsolvers.available_solvers) - {QUICK_SOLVER})
    return (QUICK_SOLVER, *others)


def keep_solver(name: str, qp: DenseQp, tolerance: float) -> KeptSolver:
    """A solver for a programme.

    Args:
        name: One of ``solver_names``.
        qp: The programme; its arrays are kept, not copied.
        tolerance: Largest residual of an answer, absolute; exact methods stay below it.

    Raises:
        NotFoundError: No such solver is installed.
    """
    if name not in solver_names():
        hint = "pip install 'opposable[solvers]' installs more."
        raise NotFoundError("installed QP solver", name, solver_names(), hint)
    if name == QUICK_SOLVER:
        return _Daqp(qp) if find_spec("daqp") else _CasadiDaqp(qp)
    kinds: dict[str, Any] = {"osqp": _Osqp, "proxqp": _Proxqp, "piqp": _Piqp}
    if name in kinds:
        kept: KeptSolver = kinds[name](qp, tolerance)
        return kept
    return _AnyQpsolver(name, qp, tolerance)


class _Base:
    def __init__(self, qp: DenseQp) -> None:
        self.qp = qp
        m, n = qp.a.shape
        self.x, self.duals = np.full(n, np.nan), np.full(m + n, np.nan)
        self.iterations, self.status = -1, ""

    def _nothing(self, status: str) -> bool:
        self.x.fill(np.nan)
        self.duals.fill(np.nan)
        self.status = status
        return False


class _CasadiDaqp(_Base):
    """DAQP as CasADi brings it: set up anew each time, in arrays that stay."""

    def __init__(self, qp: DenseQp) -> None:
        super().__init__(qp)
        self._programme = Programme("daqp", qp.a.shape[1], len(qp.a))

    def solve(self) -> bool:
        qp = self.qp
        x = self._programme.solve(
            h=qp.p, g=qp.q, a=qp.a, lba=qp.low, uba=qp.high, lbx=qp.lower, ubx=qp.upper
        )
        if x is None:
            return self._nothing("no solution")
        self.x[:], self.status = x, "solved"
        m = len(qp.a)
        np.negative(self._programme.row_prices, out=self.duals[:m])
        np.negative(self._programme.bound_prices, out=self.duals[m:])
        return True


class _Daqp(_Base):
    """DAQP's own workspace; bounds are its first rows."""

    def __init__(self, qp: DenseQp) -> None:
        super().__init__(qp)
        m, n = qp.a.shape
        self._sense = np.zeros(n + m, dtype=np.int32)
        self._sense[n : n + qp.equalities] = _DAQP_EQUALITY
        self._model: Any = None

    def solve(self) -> bool:
        qp = self.qp
        n = len(qp.q)
        if self._model is None:
            self._model = import_module("daqp").Model()
            flag, _ = self._model.setup(qp.p, qp.q, qp.a, qp.most, qp.least, self._sense)
            if flag < 0:  # limits that contradict each other are found before anything is solved
                self._model = None
                return self._nothing(f"exit flag {flag}")
        else:
            # without "sense" it starts from the active rows of its last answer
            self._model.update(H=qp.p, f=qp.q, A=qp.a, bupper=qp.most, blower=qp.least)
        x, _, flag, info = self._model.solve()
        self.iterations = int(info["iterations"])
        if flag < 1:
            self._model = None  # what it left active is no start for anything
            return self._nothing(f"exit flag {flag}")
        lam = info["lam"]
        self.x[:], self.status = x, "solved"
        self.duals[: len(qp.a)], self.duals[len(qp.a) :] = lam[n:], lam[:n]
        return True


class _Osqp(_Base):
    """OSQP with one sparsity pattern; bounds are its last rows."""

    def __init__(self, qp: DenseQp, tolerance: float) -> None:
        super().__init__(qp)
        n = len(qp.q)
        stacked = np.vstack([qp.pattern, np.eye(n, dtype=bool)])
        self._at = np.flatnonzero(stacked.ravel(order="F"))
        self._rows = np.vstack([qp.a, np.eye(n)])
        self._p_at = np.flatnonzero(np.triu(np.ones((n, n), dtype=bool)).ravel(order="F"))
        self._solver: Any = None
        self._columns, self._p_rows = csc_matrix(stacked), csc_matrix(np.triu(np.ones((n, n))))
        self._options = {
            "eps_abs": tolerance,
            "eps_rel": 0.0,
            "max_iter": MAX_ITERATIONS,
            "verbose": False,
            "polishing": False,
        }

    def solve(self) -> bool:
        qp, m = self.qp, len(self.qp.a)
        self._rows[:m] = qp.a
        values = self._rows.ravel(order="F")[self._at]
        cost = qp.p.ravel(order="F")[self._p_at]
        low, high = np.concatenate([qp.low, qp.lower]), np.concatenate([qp.high, qp.upper])
        if self._solver is None:
            table = csc_matrix((values, self._columns.indices, self._columns.indptr))
            upper = csc_matrix((cost, self._p_rows.indices, self._p_rows.indptr))
            self._solver = import_module("osqp").OSQP()
            self._solver.setup(P=upper, q=qp.q, A=table, l=low, u=high, **self._options)
        else:
            self._solver.update(q=qp.q, l=low, u=high, Px=cost, Ax=values)
        result = self._solver.solve(raise_error=False)
        self.iterations, self.status = int(result.info.iter), str(result.info.status)
        if result.info.status_val != _OSQP_SOLVED:
            # a certificate of infeasibility is no start for the next programme
            self._solver.warm_start(x=np.zeros(len(qp.q)), y=np.zeros(len(low)))
            return self._nothing(self.status)
        self.x[:], self.duals[:] = result.x, result.y
        return True


class _Proxqp(_Base):
    """ProxQP's dense solver; equalities apart, bounds as box."""

    def __init__(self, qp: DenseQp, tolerance: float) -> None:
        super().__init__(qp)
        m, n = qp.a.shape
        dense = import_module("proxsuite").proxqp.dense
        self._solver = dense.QP(n, qp.equalities, m - qp.equalities, True)
        self._solver.settings.eps_abs, self._solver.settings.eps_rel = tolerance, 0.0
        self._solver.settings.max_iter = MAX_ITERATIONS
        self._solved = import_module("proxsuite").proxqp.PROXQP_SOLVED
        self._used = False

    def solve(self) -> bool:
        qp, k = self.qp, self.qp.equalities
        data = (qp.p, qp.q, qp.a[:k], qp.low[:k], qp.a[k:], qp.low[k:], qp.high[k:])
        given = (*data, qp.lower, qp.upper)
        if self._used:
            self._solver.update(*given)
        else:
            self._solver.init(*given)
            self._used = True
        self._solver.solve()
        results = self._solver.results
        self.iterations, self.status = int(results.info.iter), str(results.info.status)
        if results.info.status != self._solved:
            self._used = False
            return self._nothing(self.status)
        self.x[:] = results.x
        self.duals[:k], self.duals[k:] = results.y, results.z
        return True


class _Piqp(_Base):
    """PIQP's dense solver; an interior-point method, so nothing to start from."""

    def __init__(self, qp: DenseQp, tolerance: float) -> None:
        super().__init__(qp)
        self._solver = import_module("piqp").DenseSolver()
        self._solver.settings.eps_abs, self._solver.settings.eps_rel = tolerance, 0.0
        self._solver.settings.eps_duality_gap_abs = tolerance
        self._solver.settings.eps_duality_gap_rel = 0.0
        self._used = False

    def solve(self) -> bool:
        qp, k = self.qp, self.qp.equalities
        a = np.asfortranarray(qp.a[:k]), np.asfortranarray(qp.a[k:])
        call = self._solver.update if self._used else self._solver.setup
        call(qp.p, qp.q, a[0], qp.low[:k], a[1], qp.low[k:], qp.high[k:], qp.lower, qp.upper)
        self._used = True
        status = self._solver.solve()
        result = self._solver.result
        self.iterations, self.status = int(result.info.iter), str(status).rsplit(".", 1)[-1]
        if self.status != "PIQP_SOLVED":
            return self._nothing(self.status)
        m = len(qp.a)
        self.x[:] = result.x
        self.duals[:k] = result.y
        self.duals[k:m] = np.asarray(result.z_u) - result.z_l
        self.duals[m:] = np.asarray(result.z_bu) - result.z_bl
        return True


class _AnyQpsolver(_Base):
    """Any other solver, called anew each time."""

    def __init__(self, name: str, qp: DenseQp, tolerance: float) -> None:
        super().__init__(qp)
        self._name = name
        self._options = {"clarabel": {"tol_feas": tolerance, "max_threads": 1}}.get(name, {})

    def solve(self) -> bool:
        qp, k = self.qp, self.qp.equalities
        high, low = np.isfinite(qp.high[k:]), np.isfinite(qp.low[k:])
        matrix: Any = np.asarray if self._name in qpsolvers.dense_solvers else csc_matrix
        programme = qpsolvers.Problem(
            P=matrix(qp.p),
            q=qp.q,
            G=matrix(np.vstack([qp.a[k:][high], -qp.a[k:][low]])),
            h=np.concatenate([qp.high[k:][high], -qp.low[k:][low]]),
            A=matrix(qp.a[:k]) if k else None,
            b=qp.low[:k] if k else None,
            lb=qp.lower,
            ub=qp.upper,
        )
        with warnings.catch_warnings():
            # that a solver found no solution is told by the return value
            warnings.simplefilter("ignore")
            try:
                solution = qpsolvers.solve_problem(programme, solver=self._name, **self._options)
            except (qpsolvers.ProblemError, qpsolvers.SolverError, ValueError) as error:
                return self._nothing(str(error))
        if not solution.found or solution.x is None:
            return self._nothing("no solution")
        m = len(qp.a)
        self.x[:], self.status = solution.x, "solved"
        if solution.z is None or solution.z_box is None or (k and solution.y is None):
            self.duals.fill(np.nan)
            return True
        self.duals[:k] = solution.y if k else 0.0
        rows = np.zeros(m - k)
        rows[high] = solution.z[: high.sum()]
        rows[low] -= solution.z[high.sum() :]
        self.duals[k:m] = rows
        self.duals[m:] = solution.z_box
        return True
