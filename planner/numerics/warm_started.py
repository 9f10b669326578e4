"""Solvers kept alive between quadratic programmes of one size and one pattern of zeros.

``keep_solver`` makes a solver object that reads a ``DenseQp`` again and again. DAQP, OSQP and
ProxQP are told of the change and start from their last answer, PIQP is told of the change, quadprog
has its arrays ready; any other solver that qpsolvers finds is called anew every time.
"""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from typing import Any

import numpy as np
import qpsolvers
from scipy.sparse import csc_matrix

from planner.errors import NotFoundError
from planner.numerics.dense_qp import DenseQp, KeptSolver, SolverBase
from planner.numerics.programme import programme
from planner.numerics.warm_started_osqp import Osqp
from planner.system.threads import without_warnings

__all__ = ["QUICK_SOLVER", "keep_solver", "solver_names"]

QUICK_SOLVER = "daqp"
"""The solver that is always there: CasADi brings it. The package ``daqp``, where it is installed,
keeps its workspace and is quicker."""

_DAQP_EQUALITY = 5
"""DAQP's mark of a row that is an equality."""

_PIQP_OPEN = 1e9
"""Upper limit of a row without limits (N), about which PIQP would print three lines a step."""

_PROXQP_INFEASIBLE = 1e-10
"""ProxQP's tolerance of a proof that nothing is allowed (-): at its own 1e-4 it refused 5 of 1000
programmes that have answers."""

_PROXQP_ITERATIONS = 50
"""Iterations, and within each, before ProxQP gives up (-): it takes about ten where there is an
answer, and seconds for the thousands of its own limits where there is none."""

_GAP = 1e-10
"""Clarabel's duality gaps: at its own 1e-8 forces were 9 mN off, where the cost is flat."""


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
    kinds: dict[str, Any] = {
        "osqp": Osqp,
        "proxqp": _Proxqp,
        "piqp": _Piqp,
        "quadprog": _Quadprog,
    }
    if name in kinds:
        kept: KeptSolver = kinds[name](qp, tolerance)
        return kept
    return _AnyQpsolver(name, qp, tolerance)


class _CasadiDaqp(SolverBase):
    """DAQP as CasADi brings it: set up anew each time, in arrays that stay."""

    def __init__(self, qp: DenseQp) -> None:
        super().__init__(qp)

    def solve(self) -> bool:
        qp = self.qp
        solver = programme("daqp", qp.a.shape[1], len(qp.a))  # that of the thread which asks now
        x = solver.solve(
            h=qp.p, g=qp.q, a=qp.a, lba=qp.low, uba=qp.high, lbx=qp.lower, ubx=qp.upper
        )
        if x is None:
            return self.nothing("no solution")
        self.status = "solved"
        return self.answer(x, -solver.row_prices, -solver.bound_prices)


class _Daqp(SolverBase):
    """DAQP's own workspace; bounds are its first rows."""

    def __init__(self, qp: DenseQp) -> None:
        super().__init__(qp)
        m, n = qp.a.shape
        self._sense = np.zeros(n + m, dtype=np.int32)
        self._sense[n : n + qp.equalities] = _DAQP_EQUALITY
        self._model: Any = None

    def solve(self) -> bool:
        """Solve; see ``KeptSolver``."""
        qp = self.qp
        if self._model is None or not len(qp.a):  # its update refuses a programme without rows
            self._model = import_module("daqp").Model()
            flag, _ = self._model.setup(qp.p, qp.q, qp.a, qp.most, qp.least, self._sense)
        else:
            # without "sense" it starts from the active rows of its last answer
            flag = self._model.update(
                H=qp.p if qp.new_p else None,
                f=qp.q if qp.new_q else None,
                A=qp.a if qp.new_a else None,
                bupper=qp.most,
                blower=qp.least,
            )
        if flag < 0:  # a row of zeros, or equalities that contradict each other
            return self._start_anew(flag)
        qp.new_p = qp.new_q = qp.new_a = False
        x, _, flag, info = self._model.solve()
        self.iterations = info["iterations"]
        if flag < 1:
            return self._start_anew(flag)
        self.status, n = "solved", len(x)
        lam = info["lam"]
        return self.answer(x, lam[n:], lam[:n])

    def _start_anew(self, flag: int) -> bool:
        """What it left active is no start for anything."""
        self._model = None
        return self.nothing(f"exit flag {flag}")


class _Proxqp(SolverBase):
    """ProxQP's dense solver; equalities apart, bounds as box."""

    def __init__(self, qp: DenseQp, tolerance: float) -> None:
        super().__init__(qp)
        m, n = qp.a.shape
        proxqp = import_module("proxsuite").proxqp
        self._solver = proxqp.dense.QP(n, qp.equalities, m - qp.equalities, True)
        settings = self._solver.settings
        settings.eps_abs, settings.eps_rel = tolerance, 0.0
        settings.max_iter = settings.max_iter_in = _PROXQP_ITERATIONS
        # else multipliers of limits that have moved away count as an answer: 20 mN off
        settings.check_duality_gap = True
        settings.eps_duality_gap_abs, settings.eps_duality_gap_rel = tolerance, 0.0
        settings.eps_primal_inf = _PROXQP_INFEASIBLE
        # from the last answer, but not from its penalties: with those too (WARM_START...) answers
        # that it called solved were 0.1 N off stationarity
        settings.initial_guess = proxqp.InitialGuess.COLD_START_WITH_PREVIOUS_RESULT
        self._solved = proxqp.PROXQP_SOLVED
        self._used = False

    def solve(self) -> bool:
        """Solve; see ``KeptSolver``."""
        qp, k = self.qp, self.qp.equalities
        data = (qp.p, qp.q, qp.a[:k], qp.low[:k], qp.a[k:], qp.low[k:], qp.high[k:])
        (self._solver.update if self._used else self._solver.init)(*data, qp.lower, qp.upper)
        self._used = True
        qp.new_p = qp.new_q = qp.new_a = False
        self._solver.solve()
        results = self._solver.results
        self.iterations, self.status = int(results.info.iter), str(results.info.status)
        if results.info.status != self._solved:
            self._used = False
            return self.nothing(self.status)
        z = np.array(results.z)
        rows = np.concatenate([results.y, z[: len(qp.a) - k]])
        return self.answer(np.array(results.x), rows, z[len(qp.a) - k :])


class _Piqp(SolverBase):
    """PIQP's dense solver; an interior-point method, so nothing to start from."""

    def __init__(self, qp: DenseQp, tolerance: float) -> None:
        super().__init__(qp)
        self._solver = import_module("piqp").DenseSolver()
        settings = self._solver.settings
        settings.eps_abs, settings.eps_rel = tolerance, 0.0
        settings.eps_duality_gap_abs, settings.eps_duality_gap_rel = tolerance, 0.0
        k, m, n = qp.equalities, *qp.a.shape
        self._equal = np.zeros((k, n), order="F")
        self._other = np.zeros((m - k, n), order="F")
        self._used = False

    def solve(self) -> bool:
        """Solve; see ``KeptSolver``."""
        qp, k = self.qp, self.qp.equalities
        high = np.where(np.isinf(qp.low[k:]), np.minimum(qp.high[k:], _PIQP_OPEN), qp.high[k:])
        given: dict[str, Any] = {"b": qp.low[:k], "h_l": qp.low[k:], "h_u": high}
        given |= {"x_l": qp.lower, "x_u": qp.upper}
        if qp.new_a:
            self._equal[:], self._other[:] = qp.a[:k], qp.a[k:]
            given |= {"A": self._equal, "G": self._other}
        if qp.new_p:
            given["P"] = qp.p
        if qp.new_q:
            given["c"] = qp.q
        if self._used:
            self._solver.update(**given)
        else:
            self._solver.setup(**given)
        self._used, qp.new_p, qp.new_q, qp.new_a = True, False, False, False
        status = self._solver.solve()
        result = self._solver.result
        self.iterations, self.status = int(result.info.iter), str(status).rsplit(".", 1)[-1]
        if self.status != "PIQP_SOLVED":
            return self.nothing(self.status)
        rows = np.concatenate([result.y, result.z_u - result.z_l])
        return self.answer(np.array(result.x), rows, result.z_bu - result.z_bl)


class _Quadprog(SolverBase):
    """quadprog, an exact dual method without a start; its rows are C'x >= b, equalities first."""

    def __init__(self, qp: DenseQp, tolerance: float) -> None:
        super().__init__(qp)
        self._solve = import_module("quadprog").solve_qp
        self._finite = b""

    def solve(self) -> bool:
        """Solve in units of the largest limit: quadprog goes round for ever on 1e4."""
        qp = self.qp
        k, n, m = qp.equalities, len(qp.q), len(qp.a)
        finite = np.isfinite(qp.limits)
        if finite.tobytes() != self._finite:
            self._finite = finite.tobytes()
            finite[:, n : n + k] = False
            low, high = (np.flatnonzero(side) for side in finite)
            equal = np.arange(n, n + k)
            self._places = np.concatenate([equal, low, high + n + m])  # in the limits
            self._used = np.concatenate([equal, low, high])  # in the table
            self._signs = np.repeat([1.0, -1.0], [k + len(low), len(high)])
        qp.new_p = qp.new_q = qp.new_a = False
        columns = (qp.table[self._used] * self._signs[:, None]).T
        ends = self._signs * qp.limits.take(self._places)
        size = max(1.0, float(np.abs(ends).max(initial=0.0)))
        try:
            x, _, _, turns, prices, _ = self._solve(qp.p, -qp.q / size, columns, ends / size, k)
        except ValueError as error:  # its way to say that there is no solution
            return self.nothing(str(error))
        self.iterations, self.status = int(turns[0]), "solved"
        duals = np.zeros(n + m)
        np.subtract.at(duals, self._used, size * self._signs * prices)
        return self.answer(size * x, duals[n:], duals[:n])


class _AnyQpsolver(SolverBase):
    """Any other solver, called anew each time."""

    def __init__(self, name: str, qp: DenseQp, tolerance: float) -> None:
        super().__init__(qp)
        self._name = name
        self._options = {
            "clarabel": {"tol_feas": tolerance, "tol_gap_abs": _GAP, "tol_gap_rel": _GAP}
        }.get(name, {})

    def solve(self) -> bool:
        """Solve in units of the largest limit: what is anew may be large."""
        qp, k = self.qp, self.qp.equalities
        high, low = np.isfinite(qp.high[k:]), np.isfinite(qp.low[k:])
        size = max(1.0, float(np.abs(qp.limits).max(where=np.isfinite(qp.limits), initial=0.0)))
        matrix: Any = np.asarray if self._name in qpsolvers.dense_solvers else csc_matrix
        task = qpsolvers.Problem(
            P=matrix(qp.p),
            q=qp.q / size,
            G=matrix(np.vstack([qp.a[k:][high], -qp.a[k:][low]])),
            h=np.concatenate([qp.high[k:][high], -qp.low[k:][low]]) / size,
            A=matrix(qp.a[:k]) if k else None,
            b=qp.low[:k] / size if k else None,
            lb=qp.lower / size,
            ub=qp.upper / size,
        )
        # that a solver found no solution is told by the return value
        with without_warnings():
            try:
                solution = qpsolvers.solve_problem(task, solver=self._name, **self._options)
            except (qpsolvers.ProblemError, qpsolvers.SolverError, ValueError) as error:
                return self.nothing(str(error))
        if not solution.found or solution.x is None:
            return self.nothing("no solution")
        m, self.status, x = len(qp.a), "solved", size * np.asarray(solution.x)
        if solution.z is None or solution.z_box is None or (k and solution.y is None):
            return self.answer(x, np.full(m, np.nan), np.full(len(x), np.nan))
        z = np.asarray(solution.z)
        rows = np.zeros(m - k)
        rows[high] = z[: high.sum()]
        rows[low] -= z[high.sum() :]
        equal = np.asarray(solution.y) if k else np.zeros(0)
        bounds = size * np.asarray(solution.z_box)
        return self.answer(x, size * np.concatenate([equal, rows]), bounds)
