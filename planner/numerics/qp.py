"""Small dense quadratic programmes: solved once, or again and again with other numbers.

    min  x'P x / 2 + q'x    s.t.  low <= A x <= high,  lower <= x <= upper

DAQP (Arnström, Bemporad, Axehill, "A dual active-set solver for embedded quadratic programming
using recursive LDL' updates", 2022) solves those of this project to rounding in 20 to 300 us. It is
a dual method: its answer is the minimum if it is feasible, which ``solve_qp`` checks.

A ``DenseQp`` is a programme in arrays that are written in place; size and pattern of zeros are
fixed. A writer of P, q or A sets ``new_p``, ``new_q`` or ``new_a``, and a solver reads only those
again; limits may change every time.

A workspace reads one ``DenseQp`` again and again. DAQP's is kept: it reads what changed and is
warm-started with the active constraints. So is ProxQP's, which needs a setting that qpsolvers does
not pass on. Every other solver is called anew through qpsolvers, for comparison; none was as fast
as DAQP in a workspace of its own either. Programmes with second-order cones are solved by
Clarabel (Goulart, Chen, "Clarabel: An interior-point solver for conic
programs with quadratic objectives", 2024).
"""

from __future__ import annotations

import math
from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, Protocol

import daqp
import numpy as np

from planner.errors import NotFoundError
from planner.spatial import FloatArray
from planner.system.threads import without_warnings

if TYPE_CHECKING:
    import qpsolvers

__all__ = ["CONE_SOLVER", "DEFAULT_SOLVER", "QpWorkspace", "qp_workspace", "solver_names"]

ALLOWED_TOL = 1e-8
"""Largest violation (-) of a row or a bound by a solution, over the larger of its largest unknown
and 1."""

_DAQP_SETTINGS = {"primal_tol": 1e-10}
"""DAQP's default lets limits be violated by 1e-6, which verdicts would refuse."""

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
    options: dict[str, Any] = {**_DAQP_SETTINGS, **settings}
    table = np.ascontiguousarray(a, dtype=np.float64)
    gradient = np.ascontiguousarray(q, dtype=np.float64)
    x, _, flag, info = daqp.solve(hessian, gradient, table, most, least, sense, **options)
    return (x, -info["lam"]) if flag > 0 else None


def violation(x: FloatArray, a: FloatArray, least: FloatArray, most: FloatArray) -> float:
    """Largest violation of a bound or row (n + m,) at x (n,), at least 0; infinite for NaN."""
    value = np.concatenate([x, a @ x])
    worst = float(np.maximum(least - value, value - most).max(initial=0.0))
    return worst if math.isfinite(worst) else math.inf


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


DEFAULT_SOLVER = "daqp"
"""The solver of quadratic programmes where none is named."""

CONE_SOLVER = "clarabel"
"""The solver of programmes with second-order cones."""

_OPTIONS: dict[str, dict[str, Any]] = {
    "clarabel": {"tol_feas": 1e-9, "tol_gap_abs": 1e-10, "tol_gap_rel": 1e-10},
    "highs": {"qp_iteration_limit": 1000},
    "osqp": {"eps_abs": 1e-9, "eps_rel": 1e-9, "max_iter": 100_000, "polishing": True},
    "piqp": {"eps_abs": 1e-9, "eps_rel": 0.0},
}
"""Options of solvers that stop too far from the answer by default (OSQP at 1e-3, Clarabel's forces
are 9 mN off where the cost is flat), and a limit for HiGHS, whose active sets may repeat for ever
(ERGO-Code/HiGHS issue 1583): where it finds an answer, it takes fewer than a hundred steps."""

_PROXQP_TOL = 1e-9
"""ProxQP's largest residuals (-)."""

_PROXQP_INFEASIBLE = 1e-10
"""ProxQP's tolerance (-) of a proof of infeasibility. At its default of 1e-4, which qpsolvers
cannot change, it refuses feasible programmes of five fingers."""

_PROXQP_ITERATIONS = 50
"""Iterations, and within each, before ProxQP gives up (-): it takes about ten where there is an
answer, and seconds for the thousands of its own limits where there is none."""

NEAR = 1e-6
"""Largest residual (-), over the largest limit, of an answer that its solver does not claim."""

_CONE_TOL = 1e-10
"""Clarabel's tolerances with cones: its own 1e-8 leaves 1e-6 of error where an answer touches
one."""


class QpWorkspace(Protocol):
    """A solver of one ``DenseQp``; each call reads what was written meanwhile."""

    x: FloatArray
    """The last answer (n,), NaN where there is none; another array after the next call."""
    iterations: int
    """Iterations of the last call, -1 where the solver does not say."""
    status: str
    """Status text of the solver (informative only)."""

    @property
    def duals(self) -> FloatArray:
        """Multipliers (m + n,) of rows and bounds: P x + q + A'y + z = 0, >= 0 at upper limits."""

    def solve(self) -> bool:
        """Solve what the programme holds now; whether the solver claims an answer."""


def solver_names() -> tuple[str, ...]:
    """Solvers that can be named, the default one first."""
    import qpsolvers  # here, since qpsolvers loads slowly

    return (DEFAULT_SOLVER, *sorted(set(qpsolvers.available_solvers) - {DEFAULT_SOLVER}))


def qp_workspace(name: str, qp: DenseQp) -> QpWorkspace:
    """A solver for a programme.

    Args:
        name: One of ``solver_names``.
        qp: The programme; its arrays are kept, not copied.

    Raises:
        NotFoundError: No such solver is installed, or it cannot do the programme's cones.
    """
    if name == DEFAULT_SOLVER and not qp.cone_sizes:
        return _Daqp(qp)
    known = solver_names()
    if qp.cone_sizes:
        known = (CONE_SOLVER,) if find_spec(CONE_SOLVER) else ()
    if name not in known:
        hint = "pip install 'opposable[solvers]' installs more."
        raise NotFoundError("installed QP solver", name, known, hint)
    if qp.cone_sizes:
        return _ClarabelCones(qp)
    return _Proxqp(qp) if name == "proxqp" else _Qpsolvers(name, qp)


class _Workspace:
    """Storage of the answer, common to all workspaces."""

    def __init__(self, qp: DenseQp) -> None:
        self.qp = qp
        m, n = qp.a.shape
        self._no_x, self._no_duals = np.full(n, np.nan), np.full(m + n, np.nan)
        self.iterations = -1
        self._nothing("")

    @property
    def duals(self) -> FloatArray:
        """Multipliers (m + n,) of rows and bounds, put together when they are asked for."""
        return np.concatenate([self._rows, self._bounds])

    def _answer(self, x: FloatArray, rows: FloatArray, bounds: FloatArray) -> bool:
        self.x, self._rows, self._bounds, self.status = x, rows, bounds, "solved"
        return True

    def _nothing(self, status: str) -> bool:
        self.x, self.status = self._no_x, status
        self._rows, self._bounds = np.split(self._no_duals, [len(self.qp.a)])
        return False


class _Daqp(_Workspace):
    """DAQP's own workspace; bounds are its first rows."""

    def __init__(self, qp: DenseQp) -> None:
        super().__init__(qp)
        m, n = qp.a.shape
        self._sense = np.zeros(n + m, dtype=np.int32)
        self._sense[n : n + qp.equalities] = _EQUALITY
        self._model: Any = None

    def solve(self) -> bool:
        """Solve; see ``QpWorkspace``."""
        qp = self.qp
        if self._model is None or not len(qp.a):  # its update refuses a programme without rows
            self._model = daqp.Model()
            self._model.settings = _DAQP_SETTINGS
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
        n, lam = len(x), info["lam"]
        return self._answer(x, lam[n:], lam[:n])

    def _start_anew(self, flag: int) -> bool:
        """Discard the active rows: without an answer they are no warm start."""
        self._model = None
        return self._nothing(f"exit flag {flag}")


class _Proxqp(_Workspace):
    """ProxQP's dense solver; equalities apart, bounds as box."""

    def __init__(self, qp: DenseQp) -> None:
        super().__init__(qp)
        m, n = qp.a.shape
        proxqp = import_module("proxsuite").proxqp
        self._solver = proxqp.dense.QP(n, qp.equalities, m - qp.equalities, True)
        settings = self._solver.settings
        settings.eps_abs, settings.eps_rel = _PROXQP_TOL, 0.0
        settings.max_iter = settings.max_iter_in = _PROXQP_ITERATIONS
        # else multipliers of limits that have moved away count as an answer: 20 mN off
        settings.check_duality_gap = True
        settings.eps_duality_gap_abs, settings.eps_duality_gap_rel = _PROXQP_TOL, 0.0
        settings.eps_primal_inf = _PROXQP_INFEASIBLE
        # from the last answer, but not from its penalties: with those too (WARM_START...) answers
        # that it called solved were 0.1 N off stationarity
        settings.initial_guess = proxqp.InitialGuess.COLD_START_WITH_PREVIOUS_RESULT
        self._solved = proxqp.PROXQP_SOLVED
        self._used = False

    def solve(self) -> bool:
        """Solve; see ``QpWorkspace``."""
        qp, k = self.qp, self.qp.equalities
        data = (qp.p, qp.q, qp.a[:k], qp.low[:k], qp.a[k:], qp.low[k:], qp.high[k:])
        (self._solver.update if self._used else self._solver.init)(*data, qp.lower, qp.upper)
        self._used = True
        qp.new_p = qp.new_q = qp.new_a = False
        self._solver.solve()
        results = self._solver.results
        self.iterations = int(results.info.iter)
        if results.info.status != self._solved:
            self._used = False
            return self._nothing(str(results.info.status))
        z = np.array(results.z)
        rows = np.concatenate([results.y, z[: len(qp.a) - k]])
        return self._answer(np.array(results.x), rows, z[len(qp.a) - k :])


class _Qpsolvers(_Workspace):
    """Any other solver, called anew each time."""

    def __init__(self, name: str, qp: DenseQp) -> None:
        super().__init__(qp)
        self._name = name

    def solve(self) -> bool:
        """Solve in units of the largest limit; see ``QpWorkspace``."""
        import qpsolvers  # here, since qpsolvers loads slowly

        qp, k, m = self.qp, self.qp.equalities, len(self.qp.a)
        unit = max(1.0, float(np.abs(qp.limits).max(where=np.isfinite(qp.limits), initial=0.0)))
        task = qp.to_qpsolvers(sparse=self._name not in qpsolvers.dense_solvers, unit=unit)
        # the return value says whether there is a solution
        with without_warnings():
            try:
                solution = qpsolvers.solve_problem(
                    task, solver=self._name, **_OPTIONS.get(self._name, {})
                )
            except (qpsolvers.ProblemError, qpsolvers.SolverError, ValueError) as error:
                return self._nothing(str(error))
        if solution.x is None:
            return self._nothing("no solution")
        x = unit * np.asarray(solution.x)
        if solution.z is None or solution.z_box is None or (k and solution.y is None):
            if solution.found:
                return self._answer(x, np.full(m, np.nan), np.full(len(x), np.nan))
            return self._nothing("no solution")
        high, low = np.isfinite(qp.high[k:]), np.isfinite(qp.low[k:])
        rows, z = np.zeros(m), np.asarray(solution.z)
        if k:
            rows[:k] = solution.y
        rows[k:][high] = z[: high.sum()]
        rows[k:][low] -= z[high.sum() :]
        self._answer(x, unit * rows, unit * np.asarray(solution.z_box))
        if not solution.found:  # some give up next to the answer: the residuals decide
            off = max(qp.violation(x), qp.dual_residual(x, self.duals))
            if not off <= NEAR * unit:
                return self._nothing("no solution")
        return True


class _ClarabelCones(_Workspace):
    """Clarabel with second-order cones: A x + s = b with s = 0, s >= 0, or s in a cone."""

    def solve(self) -> bool:
        """Solve; see ``QpWorkspace``. It gives no multipliers."""
        from scipy.sparse import csc_matrix, triu  # here, since SciPy loads slowly

        clarabel, qp = import_module("clarabel"), self.qp
        equal = qp.least == qp.most
        low, high = (np.isfinite(limit) & ~equal for limit in (qp.least, qp.most))
        parts = [qp.table[equal], -qp.table[low], qp.table[high], -qp.cones]
        values = [qp.least[equal], -qp.least[low], qp.most[high], np.zeros(len(qp.cones))]
        cones = [clarabel.ZeroConeT(int(equal.sum()))]
        cones += [clarabel.NonnegativeConeT(int(low.sum() + high.sum()))]
        cones += [clarabel.SecondOrderConeT(size) for size in qp.cone_sizes]
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        settings.tol_feas = settings.tol_gap_abs = settings.tol_gap_rel = _CONE_TOL
        task = csc_matrix(triu(qp.p)), qp.q, csc_matrix(np.vstack(parts)), np.concatenate(values)
        solution = clarabel.DefaultSolver(*task, cones, settings).solve()
        if str(solution.status) not in ("Solved", "AlmostSolved"):
            return self._nothing(str(solution.status))
        m, n = qp.a.shape
        return self._answer(np.asarray(solution.x), np.full(m, np.nan), np.full(n, np.nan))
