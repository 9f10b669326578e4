"""Grasp synthesis: the problem with its terms, its starts, and what makes a grasp better."""

from planner.synthesis.objectives.registry import OBJECTIVES
from planner.synthesis.objectives.task_wrenches import gravity_any_direction, tool_torque
from planner.synthesis.options import SynthesisOptions
from planner.synthesis.problem import GraspProblem, Start, build_problem
from planner.synthesis.seeds.draw import Seeder

__all__ = [
    "OBJECTIVES",
    "GraspProblem",
    "Seeder",
    "Start",
    "SynthesisOptions",
    "build_problem",
    "gravity_any_direction",
    "tool_torque",
]
