"""Contact forces that balance a wrench: build the programme, solve it, judge the answer."""

from __future__ import annotations

from planner.forces.build import build_force_problem, gravity_wrench
from planner.forces.dense import solver_names
from planner.forces.friction import Pyramid, pyramid_faces
from planner.forces.infeasible import Infeasibility, explain_infeasibility
from planner.forces.loop import ForceLoop, ForceStep, turned_frames
from planner.forces.problem import ForceProblem, ForceResiduals
from planner.forces.solve import (
    QUICK_SOLVER,
    ForceSolution,
    distribute_forces,
    solve_force_problem,
)

__all__ = [
    "QUICK_SOLVER",
    "ForceLoop",
    "ForceProblem",
    "ForceResiduals",
    "ForceSolution",
    "ForceStep",
    "Infeasibility",
    "Pyramid",
    "build_force_problem",
    "distribute_forces",
    "explain_infeasibility",
    "gravity_wrench",
    "pyramid_faces",
    "solve_force_problem",
    "solver_names",
    "turned_frames",
]
