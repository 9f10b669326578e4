"""Contact forces that balance a wrench: build the programme, solve it, judge the answer."""

from __future__ import annotations

from typing import TYPE_CHECKING

from planner.forces.build import (
    ForceArguments,
    LimitArguments,
    build_force_problem,
    gravity_wrench,
)
from planner.forces.problem import ForceProblem, ForceResiduals
from planner.forces.solve import (
    ForceSolution,
    LeastViolation,
    distribute_forces,
    least_violation,
    solve_force_problem,
)
from planner.system.package import lazy_names

if TYPE_CHECKING:
    from planner.contacts.friction import ExpectedLoad, grip_for_load
    from planner.forces.build import QuadraticCost
    from planner.forces.compare import (
        PyramidGap,
        SolverComparison,
        SolverRecord,
        compare_solvers,
        cone_gaps,
        turning_wrenches,
    )
    from planner.forces.compliance import GraspCompliance
    from planner.forces.infeasible import Infeasibility, explain_infeasibility
    from planner.forces.loop import ForceLoop, ForceStep
    from planner.forces.problem import turned_frames
    from planner.numerics.qp import DEFAULT_SOLVER, solver_names

__all__ = [
    "DEFAULT_SOLVER",
    "ExpectedLoad",
    "ForceArguments",
    "ForceLoop",
    "ForceProblem",
    "ForceResiduals",
    "ForceSolution",
    "ForceStep",
    "GraspCompliance",
    "Infeasibility",
    "LeastViolation",
    "LimitArguments",
    "PyramidGap",
    "QuadraticCost",
    "SolverComparison",
    "SolverRecord",
    "build_force_problem",
    "compare_solvers",
    "cone_gaps",
    "distribute_forces",
    "explain_infeasibility",
    "gravity_wrench",
    "grip_for_load",
    "least_violation",
    "solve_force_problem",
    "solver_names",
    "turned_frames",
    "turning_wrenches",
]

_HOMES = {
    "DEFAULT_SOLVER": "planner.numerics.qp",
    "ExpectedLoad": "planner.contacts.friction",
    "ForceLoop": "planner.forces.loop",
    "ForceStep": "planner.forces.loop",
    "GraspCompliance": "planner.forces.compliance",
    "Infeasibility": "planner.forces.infeasible",
    "PyramidGap": "planner.forces.compare",
    "QuadraticCost": "planner.forces.build",
    "SolverComparison": "planner.forces.compare",
    "SolverRecord": "planner.forces.compare",
    "compare_solvers": "planner.forces.compare",
    "cone_gaps": "planner.forces.compare",
    "explain_infeasibility": "planner.forces.infeasible",
    "grip_for_load": "planner.contacts.friction",
    "solver_names": "planner.numerics.qp",
    "turned_frames": "planner.forces.problem",
    "turning_wrenches": "planner.forces.compare",
}
"""What a plan does not need -> the module that defines it."""

__getattr__, __dir__ = lazy_names(__name__, _HOMES)
