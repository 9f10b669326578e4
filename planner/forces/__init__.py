"""Contact forces that balance a wrench: build the programme, solve it, judge the answer."""

from __future__ import annotations

from planner.forces.build import (
    ForceArguments,
    LimitArguments,
    build_force_problem,
    gravity_wrench,
)
from planner.forces.compare import (
    SolverComparison,
    SolverRecord,
    compare_solvers,
    turning_wrenches,
)
from planner.forces.friction import Cone, LimitSurface, Pyramid, pyramid_faces, round_cone
from planner.forces.gaps import PyramidGap, cone_gaps
from planner.forces.grip import ExpectedLoad, grip_for_load
from planner.forces.infeasible import Infeasibility, explain_infeasibility
from planner.forces.loop import ForceLoop, ForceStep
from planner.forces.placed import turned_frames
from planner.forces.priorities import LeastViolation, least_violation
from planner.forces.problem import ForceProblem, ForceResiduals
from planner.forces.solve import (
    ForceSolution,
    distribute_forces,
    solve_force_problem,
)
from planner.numerics.warm_started import QUICK_SOLVER, solver_names

__all__ = [
    "QUICK_SOLVER",
    "Cone",
    "ExpectedLoad",
    "ForceArguments",
    "ForceLoop",
    "ForceProblem",
    "ForceResiduals",
    "ForceSolution",
    "ForceStep",
    "Infeasibility",
    "LeastViolation",
    "LimitArguments",
    "LimitSurface",
    "Pyramid",
    "PyramidGap",
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
    "pyramid_faces",
    "round_cone",
    "solve_force_problem",
    "solver_names",
    "turned_frames",
    "turning_wrenches",
]
