"""From a hand pose that somebody else made to the nearest grasp that passes our verdict."""

from planner.search.refine.grasp import RefinedGrasp, refine_grasp, with_fingers
from planner.search.refine.pose import Movement

__all__ = ["Movement", "RefinedGrasp", "refine_grasp", "with_fingers"]
