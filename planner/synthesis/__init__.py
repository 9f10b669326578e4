"""Grasp synthesis: the problem with its terms, its starts, and its objectives."""

from planner.synthesis.link_spheres import hull_spheres, link_spheres
from planner.synthesis.objectives import OBJECTIVES, gravity_any_direction, tool_torque
from planner.synthesis.options import SynthesisOptions
from planner.synthesis.problem import GraspProblem, Start, build_problem
from planner.synthesis.seeds.draw import Seeder
from planner.synthesis.symbols import GraspPoint, GraspSymbols, SymbolicHand
from planner.synthesis.terms.registry import TERMS, register_term
from planner.synthesis.terms.term import Role, Rows, SphereClearance, Term

__all__ = [
    "OBJECTIVES",
    "TERMS",
    "GraspPoint",
    "GraspProblem",
    "GraspSymbols",
    "Role",
    "Rows",
    "Seeder",
    "SphereClearance",
    "Start",
    "SymbolicHand",
    "SynthesisOptions",
    "Term",
    "build_problem",
    "gravity_any_direction",
    "hull_spheres",
    "link_spheres",
    "register_term",
    "tool_torque",
]
