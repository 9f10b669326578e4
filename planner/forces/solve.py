"""``distribute_forces``: solve a force problem, recompute its residuals, and judge the answer.

"Found" means that the residuals that are recomputed
here are within ``RESIDUAL_TOL``, never that a solver said so. Where they are not, a linear
programme decides whether forces exist at all (``planner.forces.infeasible``).
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Unpack

import numpy as np

from planner.contacts import ContactSet
from planner.errors import InfeasibleError
from planner.forces.build import ForceArguments, build_force_problem
from planner.forces.infeasible import FEASIBLE, explain_infeasibility
from planner.forces.minimise import CONE_SOLVER, check_solver, minimise
from planner.forces.problem import RESIDUAL_TOL, ForceProblem, ForceResiduals
from planner.spatial import FloatArray

__all__ = ["ForceSolution", "distribute_forces", "solve_force_problem"]

DEFAULT_SOLVER = "osqp"
"""The solver of pyramids where none is named; round cones are Clarabel's."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ForceSolution:
    """Contact forces with their residuals, or why there are none.

    Attributes:
        problem: What was solved.
        found: Whether the recomputed residuals are within tolerance.
        reason: Why not, "" if found.
        cost: 1/2 x'P x + q'x; NaN if not found.
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
    cost: float
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
    contacts: ContactSet, *, solver: str | None = None, **arguments: Unpack[ForceArguments]
) -> ForceSolution:
    """Least contact forces that balance a wrench within friction, normal and actuator limits.

    May be called from any number of threads.

    Args:
        contacts: n contacts; 0 is allowed.
        solver: "daqp", or any that qpsolvers finds; None for OSQP, or for Clarabel if the cones are
            round.
        **arguments: Those of ``build_force_problem``: the ``wrench``, and what limits or costs
            forces.

    Raises:
        ContactError: The arguments do not fit together, or hold NaN.
        NotFoundError: No such solver is installed.
    """
    return solve_force_problem(build_force_problem(contacts, **arguments), solver=solver)


def solve_force_problem(problem: ForceProblem, *, solver: str | None = None) -> ForceSolution:
    """Solve a problem and judge the answer.

    Args:
        problem: What ``build_force_problem`` gave.
        solver: As for ``distribute_forces``.

    Raises:
        ContactError: Round cones and another solver than Clarabel.
        NotFoundError: No such solver is installed.
    """
    round_cones = bool(problem.cone_sizes)
    solver = solver or (CONE_SOLVER if round_cones else DEFAULT_SOLVER)
    check_solver(solver, round_cones=round_cones)
    begin = time.perf_counter()
    if problem.column_names:
        x, status = minimise(problem, solver)
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
        cost=problem.value(x),
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
    stops[problem.stops] = x[first_stop : problem.n_drive]
    return force, stops
