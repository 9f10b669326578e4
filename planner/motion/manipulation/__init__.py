"""Turning and moving an object in the hand, and putting it down: the whole plan, without executing.

    task = manipulation_task("allegro_hand", parse_object("cylinder:0.03x0.08"), mu=0.45)
    plan = plan_manipulation(task, angle=math.radians(90.0), place=(0.1, 0.05))

``sim.manipulate`` executes it.
"""

from planner.motion.manipulation.ending import Ending, Rests, planned_ending
from planner.motion.manipulation.plan import ManipulationPlan
from planner.motion.manipulation.search import (
    manipulation_of,
    plan_manipulation,
    plan_regrasping,
)
from planner.motion.manipulation.single_stroke import plan_single_stroke
from planner.motion.manipulation.task import manipulation_task, on_stand

__all__ = [
    "Ending",
    "ManipulationPlan",
    "Rests",
    "manipulation_of",
    "manipulation_task",
    "on_stand",
    "plan_manipulation",
    "plan_regrasping",
    "plan_single_stroke",
    "planned_ending",
]
