"""``distribute_forces``: solve a force problem, recompute its residuals, and judge the answer.

"Found" means that the residuals that are recomputed here are within ``RESIDUAL_TOL``, never that a
solver said so. Where the solver refuses, ``Relaxation`` has a second look; ``ForceLoop`` goes the
same way, so the two accept and refuse the same problems. A linear programme then tells why there
are no forces (``planner.forces.infeasible``).

Lexicographic answer to an infeasible wrench: least unbalanced wrench first, then least cost.

    r* = the least |G f + wrench| within friction, normal and torque limits
    f* = the least cost of forces with G f + wrench = r*

The norm counts torque divided by the problem's length. r* is unique, since the norm is strictly
convex and the wrenches that contacts can make are a convex set.

``Relaxation`` gives the balance a cost of its own instead, and follows the method of multipliers:
each round adds the multiplier of the unbalanced wrench. Where forces exist the rounds converge to
balance, and where none do, to r* and f* (Chiche, Gilbert, "How the augmented Lagrangian algorithm
can deal with an infeasible convex quadratic optimization problem", 2016). The first round leaves a
millionth of the forces more than r*, which is enough for a controller.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Unpack

import numpy as np

from planner.contacts import ContactSet
from planner.errors import ContactError, InfeasibleError, shown
from planner.forces.build import ForceArguments, build_force_problem
from planner.forces.infeasible import FEASIBLE, explain_infeasibility
from planner.forces.limits import TorqueLimits
from planner.forces.problem import (
    RESIDUAL_TOL,
    ForceProblem,
    ForceResiduals,
    force_table,
    torque_table,
    wrench_text,
)
from planner.numerics.qp import CONE_SOLVER, DEFAULT_SOLVER, DenseQp, qp_workspace
from planner.spatial import FloatArray
from planner.system.threads import built

VIOLATION_WEIGHT = 1e6
"""Cost of a squared newton of unbalanced wrench over that of a squared newton of contact force (-):
an infeasible wrench stays unbalanced by the least and a millionth of the forces."""

LARGEST_DUAL = 100.0
"""Largest plausible multiplier of the balance (N per N), beside the wrench's size: two contacts
that bear it by a friction of 0.1 have 50. Of a wrench that can be met, the first round leaves at
most this over ``VIOLATION_WEIGHT``."""

ROUNDS = 20
"""Most rounds (-)."""

AGREED = 1e-10
"""Change of the unbalanced wrench between rounds, over the wrench's size, that ends them (-)."""


class Relaxation:
    """A force programme whose first rows, the balance, are a cost; kept between wrenches.

    Attributes:
        qp: The programme with the balance.
        loose: The same without it.
        solver: The solver of ``loose``; ``solver.x`` is the last answer.
    """

    def __init__(self, qp: DenseQp, solver: str) -> None:
        """For a programme, which is kept, not copied, and a solver's name."""
        self.qp, self.loose = qp, qp.without_equalities()
        self.solver = qp_workspace(solver, self.loose)

    def solve(self, tolerance: float, *, exact: bool = False) -> FloatArray:
        """Forces (nx,) that leave the least over, NaN where the limits contradict each other.

        Args:
            tolerance: Largest unbalanced wrench that counts as balanced.
            exact: Whether to go on until rounds agree; else a second round follows only where the
                first may have left over no more than the cost lets through.
        """
        qp, loose, k = self.qp, self.loose, self.qp.equalities
        table, wanted = qp.a[:k], qp.low[:k]
        loose.p[:] = qp.p + VIOLATION_WEIGHT * (table.T @ table)
        loose.q[:] = qp.q - VIOLATION_WEIGHT * (table.T @ wanted)
        loose.a[:], loose.low[:], loose.high[:] = qp.a[k:], qp.low[k:], qp.high[k:]
        loose.lower[:], loose.upper[:] = qp.lower, qp.upper
        loose.new_p = loose.new_q = loose.new_a = True
        self.solver.solve()
        size = float(np.linalg.norm(wanted))
        last = np.full(k, np.inf)
        for _ in range(ROUNDS if exact else 1):
            missed = wanted - table @ self.solver.x
            off = float(np.abs(missed).max())
            through = exact or tolerance < off <= LARGEST_DUAL * size / VIOLATION_WEIGHT
            if not through or np.abs(missed - last).max() <= AGREED * size:
                break
            last = missed
            loose.q -= VIOLATION_WEIGHT * (table.T @ missed)
            loose.new_q = True
            self.solver.solve()
        return self.solver.x


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
        unknowns: (nx,), forces and the problem's other unknowns; NaN if not found.
        joint_torques: (nv,), what the joints need for them and for gravity, N m; (0,) without
            Jacobians, NaN if not found.
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
    unknowns: FloatArray
    joint_torques: FloatArray
    residuals: ForceResiduals
    unresisted_wrench: FloatArray
    fraction: float
    limits: tuple[str, ...]
    solver: str
    status: str
    solve_time_s: float

    @property
    def actuator_forces(self) -> FloatArray:
        """Forces of the actuators (nu,), N m; of those outside the problem what holds gravity.

        (0,) without an actuation, NaN if not found.
        """
        return self._hand_forces[0]

    @property
    def stop_forces(self) -> FloatArray:
        """Multipliers of the stops (ns,), N m; likewise."""
        return self._hand_forces[1]

    @built
    def _hand_forces(self) -> tuple[FloatArray, FloatArray]:
        """Both, computed when they are first asked for: the verdict needs the rows alone."""
        return _hand_forces(self.problem, self.unknowns, self.joint_torques)

    def raise_if_infeasible(self) -> ForceSolution:
        """This solution, if it was found.

        Raises:
            InfeasibleError: It was not; carries the reason and the unbalanced wrench.
        """
        if not self.found:
            remedy = "Move the contacts, raise friction or limits, or ask for less."
            raise InfeasibleError(f"{self.reason}. {remedy}", self.unresisted_wrench)
        return self

    def __repr__(self) -> str:
        """One line; the attributes hold the rest."""
        return f"<ForceSolution of {len(self.contacts)} contacts, {self._verdict}>"

    def __str__(self) -> str:
        """A screen: forces with their friction, torques beside their limits, or why not."""
        p = self.problem
        lines = [f"contact forces: {self._verdict}", f"  against {wrench_text(p.wrench)}"]
        if not self.found:
            lines.append(f"  {self.reason}")
            return "\n".join(lines)
        lines += force_table(p.contact_names, self.forces, self.contacts.friction_utilisation())
        if p.torque_limits is not None and p.q is not None:
            a = p.torque_limits.actuation
            limits = a.force_limits(p.q)
            lines += torque_table(
                a.names, self.actuator_forces, limits, a.stop_names, self.stop_forces
            )
        elif len(self.joint_torques):
            lines.append(f"  largest joint torque {np.abs(self.joint_torques).max():.4f} N m")
        lines.append(
            f"  largest residual {self.residuals.worst:.1e} N (torques divided by "
            f"{1e3 * p.length:.3g} mm); cost {self.cost:.4g}"
        )
        return "\n".join(lines)

    @property
    def _verdict(self) -> str:
        if not self.found:
            return "not found"
        if not self.solver:
            return "found, nothing to solve"
        return f"found by {self.solver} in {1e3 * self.solve_time_s:.2g} ms"


@dataclass(frozen=True, kw_only=True, eq=False)
class LeastViolation:
    """Forces for the part of a wrench that can be met.

    Attributes:
        solution: Of the problem with the resisted part; ``solution.forces`` are the forces. Not
            found where the limits contradict each other whatever the wrench.
        left_over: (6,), G f + wrench, N and N m; 0 where everything is met.
        size: |left_over| with torque divided by the length, N.
    """

    solution: ForceSolution
    left_over: FloatArray
    size: float


def distribute_forces(
    contacts: ContactSet, *, solver: str | None = None, **arguments: Unpack[ForceArguments]
) -> ForceSolution:
    """Least contact forces that balance a wrench within friction, normal and actuator limits.

    May be called from any number of threads.

    Args:
        contacts: n contacts; 0 is allowed.
        solver: "daqp", or any that qpsolvers finds; None for DAQP, or for Clarabel if the cones are
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
    solver = _solver_for(problem, solver)
    if not problem.column_names:
        return _judged(problem, np.zeros(0), "", "nothing to solve", 0.0)
    begin = time.perf_counter()
    qp = problem.dense_qp(problem.force_scale)
    workspace = qp_workspace(solver, qp)
    workspace.solve()
    x, status = workspace.x, workspace.status
    if not qp.violation(x) <= RESIDUAL_TOL:
        x = Relaxation(qp, solver).solve(RESIDUAL_TOL)
    return _judged(problem, _unscaled(problem, x), solver, status, time.perf_counter() - begin)


def least_violation(problem: ForceProblem, *, solver: str | None = None) -> LeastViolation:
    """Solve a problem; if it is infeasible, minimise the unbalanced wrench, then the cost.

    Args:
        problem: What ``build_force_problem`` gave.
        solver: As for ``distribute_forces``.

    Raises:
        ContactError: Round cones and another solver than Clarabel.
        NotFoundError: No such solver is installed.
    """
    solution = solve_force_problem(problem, solver=solver)
    if solution.found:
        return LeastViolation(solution=solution, left_over=np.zeros(6), size=0.0)
    solver, x = _solver_for(problem, solver), np.zeros(0)
    begin = time.perf_counter()
    if problem.column_names:
        relaxation = Relaxation(problem.dense_qp(problem.force_scale), solver)
        x = relaxation.solve(RESIDUAL_TOL, exact=True)
        if not relaxation.loose.violation(x) <= RESIDUAL_TOL:
            return LeastViolation(solution=solution, left_over=problem.wrench, size=np.inf)
    x = _unscaled(problem, x)
    wrench = problem.rows[:6] @ x
    balance = np.concatenate([wrench, problem.low[6:]]), np.concatenate([wrench, problem.high[6:]])
    met = replace(problem, wrench=-wrench, low=balance[0], high=balance[1])
    left = wrench + problem.wrench
    return LeastViolation(
        solution=_judged(met, x, solver, "least violation", time.perf_counter() - begin),
        left_over=left,
        size=float(np.linalg.norm(problem.row_scale[:6] * left)),
    )


def _solver_for(problem: ForceProblem, solver: str | None) -> str:
    """The solver that is asked for, or the one for the problem's cones.

    Raises:
        ContactError: Round cones and another solver than Clarabel.
    """
    if not problem.cone_sizes:
        return solver or DEFAULT_SOLVER
    if solver not in (None, CONE_SOLVER):
        raise ContactError(
            f"solver {shown(solver)} cannot do round cones; leave it out for {CONE_SOLVER!r}, or "
            "use pyramids (cone='inscribed')"
        )
    return CONE_SOLVER


def _unscaled(problem: ForceProblem, x: FloatArray) -> FloatArray:
    """Unknowns in N and N m; bounds hold exactly: a component without friction is 0, not 1e-15."""
    forces = problem.force_scale * problem.column_scale * x
    return np.minimum(np.maximum(forces, problem.lower), problem.upper)


def _judged(
    problem: ForceProblem, x: FloatArray, solver: str, status: str, elapsed: float
) -> ForceSolution:
    """The verdict on unknowns (nx,), NaN where the solver gave nothing."""
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
    torques = problem.joint_torques(x)
    return ForceSolution(
        problem=problem,
        found=found,
        reason=reason,
        cost=problem.value(x),
        forces=forces,
        contacts=problem.contacts.with_forces(forces),
        unknowns=x,
        joint_torques=torques,
        residuals=residuals,
        unresisted_wrench=verdict.wrench,
        fraction=verdict.fraction,
        limits=verdict.limits,
        solver=solver,
        status=status,
        solve_time_s=elapsed,
    )


def _hand_forces(
    problem: ForceProblem, x: FloatArray, torques: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Actuator forces (nu,) and stop forces (ns,), joints outside the problem holding gravity."""
    if problem.torque_limits is None or problem.q is None:
        return np.zeros(0), np.zeros(0)
    actuation, q = problem.torque_limits.actuation, problem.q
    # of our own: whoever has the problem may have taken its limits to another q
    limits = TorqueLimits(actuation, 1.0)
    limits.gravity[:] = problem.gravity_torque
    limits.at(q, np.zeros((2, len(q))))
    nu, ns = len(actuation.names), len(actuation.stop_names)
    if not np.isfinite(torques).all():
        return np.full(nu, np.nan), np.full(ns, np.nan)
    made = limits.shares(torques, x[len(x) - problem.n_extra :])
    inside = np.zeros(len(torques), dtype=np.bool_)
    inside[problem.joints] = True
    idle = actuation.split_torque(q, np.where(inside, 0.0, problem.gravity_torque))
    tables = actuation.moment, actuation.stop_rows
    actuators, stops = (
        np.where((table[:, inside] != 0).any(axis=1), mine, others)
        for table, mine, others in zip(tables, made, idle, strict=True)
    )
    return actuators, stops
