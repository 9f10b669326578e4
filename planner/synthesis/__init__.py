"""Grasp synthesis: the NLP, its starts, the pre-grasp, and the verdict on the true geometry."""

from planner.synthesis.options import SynthesisOptions
from planner.synthesis.pregrasp import Approach, find_approach
from planner.synthesis.problem import GraspProblem, Start, build_problem
from planner.synthesis.seeds import Seeder
from planner.synthesis.verify import Verification, contacts_at, verify

__all__ = [
    "Approach",
    "GraspProblem",
    "Seeder",
    "Start",
    "SynthesisOptions",
    "Verification",
    "build_problem",
    "contacts_at",
    "find_approach",
    "verify",
]
