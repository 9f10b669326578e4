"""Two-level priorities: where a wrench cannot be met, first the least violation, then the cost.

    level 1     r* = the least |G f + wrench| within friction, normal and actuator limits
    level 2     the least cost of forces with G f + wrench = r*

The norm counts torque divided by the problem's length. r* is unique, since the norm is strictly
convex and the wrenches that contacts can make are a convex set; the forces are unique by level 2.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from planner.errors import ContactError
from planner.forces.minimise import CONE_SOLVER, minimise
from planner.forces.problem import RESIDUAL_TOL, ForceProblem
from planner.forces.solve import ForceSolution, solve_force_problem
from planner.numerics.warm_started import QUICK_SOLVER
from planner.spatial import FloatArray

__all__ = ["LeastViolation", "least_violation"]

NEARNESS = 1e-4
"""Cost of a change of forces in a round of level 1, beside that of what is left over (-): it makes
the programme strictly convex, and fades as rounds agree."""

ROUNDS = 20
"""Most rounds of level 1 (-); 3 to 6 were needed."""

AGREED = 1e-9
"""Change of what is left over at which rounds agree, in units of the force scale (-)."""


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


def least_violation(problem: ForceProblem) -> LeastViolation:
    """Solve a problem, or what comes nearest to it.

    Args:
        problem: With the balance as an equality; pyramids are solved by DAQP, round cones by
            Clarabel.

    Raises:
        ContactError: The balance is a cost already.
        NotFoundError: Round cones, and Clarabel is not installed.
    """
    if problem.balance_cost is not None:
        raise ContactError("balance_cost is given; leave it out, the balance is the first priority")
    solver = CONE_SOLVER if problem.cone_sizes else QUICK_SOLVER
    solution = solve_force_problem(problem, solver=solver)
    if solution.found:
        return LeastViolation(solution=solution, left_over=np.zeros(6), size=0.0)
    wrench = _nearest_wrench(problem, solver)
    if wrench is None:
        return LeastViolation(solution=solution, left_over=problem.wrench, size=np.inf)
    size = float(np.linalg.norm(problem.row_scale[:6] * (wrench + problem.wrench)))
    if size <= RESIDUAL_TOL * problem.force_scale:  # the solver missed forces that exist
        return LeastViolation(solution=solution, left_over=np.zeros(6), size=0.0)
    met = replace(
        problem,
        wrench=-wrench,
        equality_value=np.concatenate([wrench, problem.equality_value[6:]]),
    )
    return LeastViolation(
        solution=solve_force_problem(met, solver=solver),
        left_over=wrench + problem.wrench,
        size=size,
    )


def _nearest_wrench(problem: ForceProblem, solver: str) -> FloatArray | None:
    """What contacts can do (6,) that is nearest to minus the wrench; None if nothing is allowed.

    Rounds of the proximal-point method: each adds the cost of leaving the forces of the last.
    """
    relaxed = _relaxed(problem)
    near = relaxed.quadratic.copy()
    near[-6:] = 0.0  # forces alone
    x = np.zeros(len(near))
    wrench: FloatArray | None = None
    for _ in range(ROUNDS):
        x, _ = minimise(replace(relaxed, linear=-near @ x), solver)
        if not np.isfinite(x).all():
            return wrench
        last, wrench = wrench, problem.equality[:6] @ x[:-6]
        if last is not None:
            change = np.abs(problem.row_scale[:6] * (wrench - last)).max()
            if change <= AGREED * problem.force_scale:
                break
    return wrench


def _relaxed(problem: ForceProblem) -> ForceProblem:
    """Level 1: the residual has columns and the cost, forces cost ``NEARNESS`` of theirs."""
    nx, scale = len(problem.column_names), problem.row_scale[:6]
    wide = np.vstack([-np.eye(6), np.zeros((len(problem.equality) - 6, 6))])
    quadratic = np.zeros((nx + 6, nx + 6))
    quadratic[:nx, :nx] = NEARNESS * np.diag(1.0 / problem.column_scale**2)
    quadratic[nx:, nx:] = np.diag(scale**2)
    return replace(
        problem,
        quadratic=quadratic,
        linear=np.zeros(nx + 6),
        equality=np.hstack([problem.equality, wide]),
        faces=np.hstack([problem.faces, np.zeros((len(problem.faces), 6))]),
        cones=np.hstack([problem.cones, np.zeros((len(problem.cones), 6))]),
        lower=np.concatenate([problem.lower, np.full(6, -np.inf)]),
        upper=np.concatenate([problem.upper, np.full(6, np.inf)]),
        column_names=(*problem.column_names, *(f"left over {i}" for i in range(6))),
        column_scale=np.concatenate([problem.column_scale, 1 / scale]),
        balance_cost=1.0,
    )
