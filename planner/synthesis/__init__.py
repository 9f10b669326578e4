"""Grasp synthesis: the NLP, its starts, the pre-grasp, and the verdict on the true geometry."""

from planner.synthesis.objectives import OBJECTIVES
from planner.synthesis.options import SynthesisOptions
from planner.synthesis.pregrasp import Approach, find_approach
from planner.synthesis.problem import GraspProblem, Start, build_problem
from planner.synthesis.seeds import Seeder
from planner.synthesis.task_wrenches import gravity_any_direction, tool_torque
from planner.synthesis.verify import Verification, contacts_at, verify

__all__ = [
    "OBJECTIVES",
    "Approach",
    "GraspProblem",
    "Seeder",
    "Start",
    "SynthesisOptions",
    "Verification",
    "build_problem",
    "contacts_at",
    "find_approach",
    "gravity_any_direction",
    "tool_torque",
    "verify",
]
