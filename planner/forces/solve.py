"""``distribute_forces``: solve a force problem, recompute its residuals, and judge the answer.

Any solver that qpsolvers finds can be named. "Found" means that the residuals that are recomputed
here are within ``RESIDUAL_TOL``, never that a solver said so. Where they are not, a linear
programme decides whether forces exist at all (``planner.forces.infeasible``).
"""

from __future__ import annotations

import time
import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
import qpsolvers
from numpy.typing import ArrayLike
from scipy.sparse import csc_matrix

from planner.actuation import Actuation
from planner.contacts import ContactSet
from planner.errors import InfeasibleError, NotFoundError
from planner.forces.build import build_force_problem
from planner.forces.friction import Pyramid
from planner.forces.infeasible import FEASIBLE, explain_infeasibility
from planner.forces.problem import RESIDUAL_TOL, ForceProblem, ForceResiduals
from planner.programme import programme
from planner.spatial import FloatArray

__all__ = ["QUICK_SOLVER", "ForceSolution", "distribute_forces", "solve_force_problem"]

SOLVER_OPTIONS: dict[str, dict[str, Any]] = {
    "osqp": {"eps_abs": 1e-9, "eps_rel": 1e-9, "max_iter": 100_000, "polishing": True},
    "proxqp": {"eps_abs": 1e-9, "eps_rel": 0.0},
}
"""Both stop too far from ``RESIDUAL_TOL`` by default (OSQP at 1e-3). The other solvers are exact
enough as they are."""


QUICK_SOLVER = "daqp"
"""The solver that needs no way through qpsolvers: exact to rounding in 0.1 to 0.2 ms for a hand's
grasp, where OSQP takes 3 to 5, so it is the search's. CasADi brings it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ForceSolution:
    """Contact forces with their residuals, or why there are none.

    Attributes:
        problem: What was solved.
        found: Whether the recomputed residuals are within tolerance.
        reason: Why not, "" if found.
        forces: (n, 4), on the object, in the contact frames: f_n, f_t1, f_t2 (N), tau_n (N m); NaN
            if not found.
        contacts: The problem's contacts with these forces.
        joint_torques: (nv,), what the joints need for them and for gravity, N m; (0,) without
            Jacobians, NaN if not found.
        actuator_forces: (nu,), N m; of actuators outside the problem what holds gravity; (0,)
            without an actuation, NaN if not found.
        stop_forces: (ns,), multipliers of the stops, N m; likewise.
        residuals: Recomputed residuals; infinite if the solver gave nothing.
        unresisted_wrench: (6,), part of the wrench that cannot be resisted, N and N m; 0 if found.
        fraction: Share of the wrench that can be resisted at best (-); 1 if found.
        limits: What stands in the way, by name; empty if found.
        solver: Its name, "" where there was nothing to solve.
        status: What the solver said (informative only).
        solve_time_s: Wall time in the solver and its interface, s.
    """

    problem: ForceProblem
    found: bool
    reason: str
    forces: FloatArray
    contacts: ContactSet
    joint_torques: FloatArray
    actuator_forces: FloatArray
    stop_forces: FloatArray
    residuals: ForceResiduals
    unresisted_wrench: FloatArray
    fraction: float
    limits: tuple[str, ...]
    solver: str
    status: str
    solve_time_s: float

    def raise_if_infeasible(self) -> ForceSolution:
        """This solution, if it was found.

        Raises:
            InfeasibleError: It was not; carries the reason and the wrench that is left over.
        """
        if not self.found:
            remedy = "Move the contacts, raise friction or limits, or ask for less."
            raise InfeasibleError(f"{self.reason}. {remedy}", self.unresisted_wrench)
        return self


def distribute_forces(
    contacts: ContactSet,
    *,
    wrench: ArrayLike,
    edges: int = 8,
    cone: Pyramid = "inscribed",
    min_normal: ArrayLike = 0.0,
    max_normal: ArrayLike = np.inf,
    friction_scale: float = 1.0,
    tangential_cost: float = 1.0,
    jacobians: ArrayLike | None = None,
    actuation: Actuation | None = None,
    q: ArrayLike | None = None,
    gravity_torque: ArrayLike | None = None,
    solver: str = "osqp",
) -> ForceSolution:
    """Least contact forces that balance a wrench within friction, normal and actuator limits.

    Arguments are those of ``build_force_problem``; ``solver`` is "daqp" or any that qpsolvers
    finds.

    Raises:
        ContactError: The arguments do not fit together, or hold NaN.
        NotFoundError: No such solver is installed.
    """
    problem = build_force_problem(
        contacts,
        wrench=wrench,
        edges=edges,
        cone=cone,
        min_normal=min_normal,
        max_normal=max_normal,
        friction_scale=friction_scale,
        tangential_cost=tangential_cost,
        jacobians=jacobians,
        actuation=actuation,
        q=q,
        gravity_torque=gravity_torque,
    )
    return solve_force_problem(problem, solver=solver)


def solve_force_problem(problem: ForceProblem, *, solver: str = "osqp") -> ForceSolution:
    """Solve a problem and judge the answer.

    Raises:
        NotFoundError: No such solver is installed.
    """
    if solver != QUICK_SOLVER and solver not in qpsolvers.available_solvers:
        hint = "pip install 'qpsolvers[open_source_solvers]' installs more."
        raise NotFoundError("installed QP solver", solver, qpsolvers.available_solvers, hint)
    begin = time.perf_counter()
    if problem.column_names:
        x, status = _minimise(problem, solver)
    else:
        x, status, solver = np.zeros(0), "nothing to solve", ""
    elapsed = time.perf_counter() - begin
    residuals = problem.residuals(x)
    found = bool(residuals.worst <= RESIDUAL_TOL * problem.force_scale)
    verdict, reason = FEASIBLE, ""
    if not found:
        verdict = explain_infeasibility(problem)
        reason = verdict.reason or (
            f"forces exist, but solver {solver!r} missed them by {residuals.worst:.1e} N "
            f"({status}); name another solver"
        )
        x = np.full(len(x), np.nan)
    forces = problem.contact_forces(x) if found else np.full((len(problem.contacts), 4), np.nan)
    actuator_forces, stop_forces = _hand_forces(problem, x)
    return ForceSolution(
        problem=problem,
        found=found,
        reason=reason,
        forces=forces,
        contacts=problem.contacts.with_forces(forces),
        joint_torques=problem.joint_torques(x),
        actuator_forces=actuator_forces,
        stop_forces=stop_forces,
        residuals=residuals,
        unresisted_wrench=verdict.wrench,
        fraction=verdict.fraction,
        limits=verdict.limits,
        solver=solver,
        status=status,
        solve_time_s=elapsed,
    )


def _minimise(problem: ForceProblem, solver: str) -> tuple[FloatArray, str]:
    """The minimiser (nx,), NaN where the solver gave nothing, and what it said.

    The solver sees forces in units of ``force_scale``, torques divided by ``length``, so that its
    absolute tolerances mean the same for a pea and for a brick.
    """
    unit = problem.column_scale * problem.force_scale
    cost = problem.cost * problem.column_scale**2
    faces = problem.faces * problem.column_scale
    rows = problem.row_scale[:, None] * problem.equality * problem.column_scale
    if solver == QUICK_SOLVER:
        return _by_daqp(problem, cost, rows, faces)
    matrix = np.asarray if solver in qpsolvers.dense_solvers else csc_matrix
    programme = qpsolvers.Problem(
        P=matrix(np.diag(cost)),
        q=np.zeros(len(cost)),
        G=matrix(faces) if len(faces) else None,
        h=np.zeros(len(faces)) if len(faces) else None,
        A=matrix(rows),
        b=problem.row_scale * problem.equality_value / problem.force_scale,
        lb=problem.lower / unit,
        ub=problem.upper / unit,
    )
    nothing = np.full(len(cost), np.nan)
    with warnings.catch_warnings():
        # That a solver found no solution is no news to a caller who gets the reason.
        warnings.simplefilter("ignore")
        try:
            solution = qpsolvers.solve_problem(
                programme, solver=solver, **SOLVER_OPTIONS.get(solver, {})
            )
        except (qpsolvers.ProblemError, qpsolvers.SolverError, ValueError) as error:
            return nothing, str(error)
    info = solution.extras.get("info")
    status = getattr(info, "status", "solved" if solution.found else "no solution")
    if solution.x is None:
        return nothing, str(status)
    # Bounds hold exactly, so that a component without friction is 0 and not 1e-15.
    x = np.clip(unit * np.asarray(solution.x, dtype=np.float64), problem.lower, problem.upper)
    return x, str(status)


def _by_daqp(
    problem: ForceProblem, cost: FloatArray, rows: FloatArray, faces: FloatArray
) -> tuple[FloatArray, str]:
    """The same by the DAQP that CasADi brings, without the way through sparse matrices."""
    unit = problem.column_scale * problem.force_scale
    values = problem.row_scale * problem.equality_value / problem.force_scale
    n, table = len(cost), np.vstack([rows, faces])
    x = programme("daqp", n, len(table)).solve(
        h=np.diag(cost),
        g=np.zeros(n),
        a=table,
        lba=np.concatenate([values, np.full(len(faces), -np.inf)]),
        uba=np.concatenate([values, np.zeros(len(faces))]),
        lbx=problem.lower / unit,
        ubx=problem.upper / unit,
    )
    if x is None:
        return np.full(n, np.nan), "no solution"
    return np.clip(unit * x, problem.lower, problem.upper), "solved"


def _hand_forces(problem: ForceProblem, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Actuator forces (nu,) and stop multipliers (ns,), idle joints holding gravity alone."""
    actuation, q = problem.actuation, problem.q
    if actuation is None or q is None:
        return np.zeros(0), np.zeros(0)
    idle = problem.gravity_torque.copy()
    idle[problem.joints] = 0.0
    force, stops = actuation.split_torque(q, idle)
    first_stop = problem.n_force + len(problem.actuators)
    force[problem.actuators] = x[problem.n_force : first_stop]
    stops[problem.stops] = x[first_stop:]
    return force, stops
