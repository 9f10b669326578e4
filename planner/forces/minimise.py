"""The minimiser of a force problem by a named solver; whether it is one is judged elsewhere.

Solvers see forces in units of ``ForceProblem.force_scale``, torques divided by ``length``, so that
their absolute tolerances mean the same for a pea and for a brick. Round cones go to Clarabel
(Goulart, Chen, "Clarabel: An interior-point solver for conic programs with quadratic objectives",
2024), which takes second-order cones beside a quadratic cost.
"""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from typing import Any

import numpy as np
import qpsolvers
from scipy.sparse import csc_matrix, triu

from planner.errors import ContactError, NotFoundError
from planner.forces.problem import ForceProblem
from planner.numerics.programme import programme
from planner.numerics.warm_started import QUICK_SOLVER, solver_names
from planner.spatial import FloatArray
from planner.system.threads import without_warnings

__all__ = ["CONE_SOLVER", "check_solver", "minimise"]

CONE_SOLVER = "clarabel"
"""The solver of second-order cones."""

SOLVER_OPTIONS: dict[str, dict[str, Any]] = {
    "osqp": {"eps_abs": 1e-9, "eps_rel": 1e-9, "max_iter": 100_000, "polishing": True},
    "proxqp": {"eps_abs": 1e-9, "eps_rel": 0.0, "max_iter": 1000},
}
"""Both stop too far from ``RESIDUAL_TOL`` by default (OSQP at 1e-3); ProxQP's 10,000 iterations
can take a minute on what has no answer. The other solvers are exact
enough as they are."""

CONE_TOL = 1e-10
"""Clarabel's tolerances, in units of the force scale: its own 1e-8 leaves 1e-6 of error where an
answer touches a cone."""


def check_solver(solver: str, *, round_cones: bool) -> None:
    """Refuse a solver that is not there, or cannot do round cones.

    Raises:
        ContactError: Round cones and another solver than Clarabel.
        NotFoundError: No such solver is installed.
    """
    if round_cones and solver != CONE_SOLVER:
        raise ContactError(
            f"solver {solver!r} cannot do round cones; leave it out for {CONE_SOLVER!r}, or use "
            "pyramids (cone='inscribed')"
        )
    known = solver_names()
    if solver not in known or (round_cones and not find_spec(CONE_SOLVER)):
        hint = "pip install 'opposable[solvers]' installs more."
        raise NotFoundError("installed QP solver", solver, known, hint)


class _Scaled:
    """A problem in the units of the module."""

    def __init__(self, problem: ForceProblem) -> None:
        size = problem.force_scale
        self.unit = problem.column_scale * size
        scale = problem.column_scale
        self.p = problem.quadratic * np.outer(scale, scale)
        self.q = problem.linear * scale / size
        self.rows = problem.row_scale[:, None] * problem.equality * scale
        self.values = problem.row_scale * problem.equality_value / size
        self.faces = problem.faces * scale
        self.cones = problem.cones * scale
        self.cone_sizes = problem.cone_sizes
        self.lower, self.upper = problem.lower / self.unit, problem.upper / self.unit


def minimise(problem: ForceProblem, solver: str) -> tuple[FloatArray, str]:
    """The minimiser (nx,), NaN where the solver gave nothing, and what it said."""
    scaled = _Scaled(problem)
    if problem.cone_sizes:
        x, status = _by_clarabel(scaled)
    elif solver == QUICK_SOLVER:
        x, status = _by_daqp(scaled)
    else:
        x, status = _by_qpsolvers(scaled, solver)
    if x is None:
        return np.full(len(scaled.unit), np.nan), status
    # Bounds hold exactly, so that a component without friction is 0 and not 1e-15.
    return np.clip(scaled.unit * x, problem.lower, problem.upper), status


def _by_qpsolvers(scaled: _Scaled, solver: str) -> tuple[FloatArray | None, str]:
    matrix: Any = np.asarray if solver in qpsolvers.dense_solvers else csc_matrix
    faces = len(scaled.faces)
    task = qpsolvers.Problem(
        P=matrix(scaled.p),
        q=scaled.q,
        G=matrix(scaled.faces) if faces else None,
        h=np.zeros(faces) if faces else None,
        A=matrix(scaled.rows),
        b=scaled.values,
        lb=scaled.lower,
        ub=scaled.upper,
    )
    # That a solver found no solution is no news to a caller who gets the reason.
    with without_warnings():
        try:
            solution = qpsolvers.solve_problem(
                task, solver=solver, **SOLVER_OPTIONS.get(solver, {})
            )
        except (qpsolvers.ProblemError, qpsolvers.SolverError, ValueError) as error:
            return None, str(error)
    info = solution.extras.get("info")
    status = str(getattr(info, "status", "solved" if solution.found else "no solution"))
    return (None if solution.x is None else np.asarray(solution.x, dtype=np.float64)), status


def _by_daqp(scaled: _Scaled) -> tuple[FloatArray | None, str]:
    """By the DAQP that CasADi brings, without the way through sparse matrices."""
    n, table = len(scaled.q), np.vstack([scaled.rows, scaled.faces])
    faces = len(scaled.faces)
    x = programme("daqp", n, len(table)).solve(
        h=scaled.p,
        g=scaled.q,
        a=table,
        lba=np.concatenate([scaled.values, np.full(faces, -np.inf)]),
        uba=np.concatenate([scaled.values, np.zeros(faces)]),
        lbx=scaled.lower,
        ubx=scaled.upper,
    )
    return x, "no solution" if x is None else "solved"


def _by_clarabel(scaled: _Scaled) -> tuple[FloatArray | None, str]:
    """Minimise 1/2 x'Px + q'x with A x + s = b, s in {0}, >= 0, and second-order cones."""
    clarabel = import_module("clarabel")
    n, eye = len(scaled.q), np.eye(len(scaled.q))
    fixed = scaled.lower == scaled.upper
    low, high = (np.isfinite(limit) & ~fixed for limit in (scaled.lower, scaled.upper))
    equal = np.vstack([scaled.rows, eye[fixed]])
    below = np.vstack([scaled.faces, -eye[low], eye[high]])
    table = np.vstack([equal, below, -scaled.cones]).reshape(-1, n)
    values = np.concatenate(
        [
            scaled.values,
            scaled.lower[fixed],
            np.zeros(len(scaled.faces)),
            -scaled.lower[low],
            scaled.upper[high],
            np.zeros(len(scaled.cones)),
        ]
    )
    cones = [clarabel.ZeroConeT(len(equal)), clarabel.NonnegativeConeT(len(below))]
    cones += [clarabel.SecondOrderConeT(size) for size in scaled.cone_sizes]
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_feas = settings.tol_gap_abs = settings.tol_gap_rel = CONE_TOL
    quadratic = csc_matrix(triu(scaled.p))
    solver = clarabel.DefaultSolver(quadratic, scaled.q, csc_matrix(table), values, cones, settings)
    solution = solver.solve()
    status = str(solution.status)
    if status not in ("Solved", "AlmostSolved"):
        return None, status
    return np.asarray(solution.x, dtype=np.float64), status
