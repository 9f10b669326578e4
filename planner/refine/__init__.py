"""From a hand pose that somebody else made to the nearest grasp that passes our verdict."""

from planner.refine.grasp import refine_grasp, with_fingers
from planner.refine.movement import Movement
from planner.refine.refined import RefinedGrasp

__all__ = ["Movement", "RefinedGrasp", "refine_grasp", "with_fingers"]
