"""Movements of an object in the hand: searched over knots, verified like grasps, phase by phase.

    task = manipulation_task("allegro_hand", parse_object("cylinder:0.03x0.08"), mu=0.45)
    plan = plan_manipulation(task, angle=math.radians(90.0), place=(0.1, 0.05))

``sim.manipulate`` executes it.
"""

from planner.motion.ending import Rests, planned_ending
from planner.motion.gait import plan_gait
from planner.motion.goals import plan_reorientation
from planner.motion.handover import plan_handover
from planner.motion.manipulation import manipulation_of, plan_manipulation, plan_regrasping
from planner.motion.order import Lift, NoOrder, Order, find_order
from planner.motion.path import ObjectPath
from planner.motion.phase import Ending, Handover, Knot, Relocation, Stroke, ToolUse
from planner.motion.plan import (
    GaitPlan,
    Limit,
    ManipulationPlan,
    MotionPlan,
    MotionRecord,
    MovementPlan,
)
from planner.motion.regrasp import cut_motion, plan_back, plan_others
from planner.motion.search import MotionAttempt, motion_attempts, plan_motion
from planner.motion.single_stroke import plan_single_stroke
from planner.motion.task import manipulation_task, on_stand

__all__ = [
    "Ending",
    "GaitPlan",
    "Handover",
    "Knot",
    "Lift",
    "Limit",
    "ManipulationPlan",
    "MotionAttempt",
    "MotionPlan",
    "MotionRecord",
    "MovementPlan",
    "NoOrder",
    "ObjectPath",
    "Order",
    "Relocation",
    "Rests",
    "Stroke",
    "ToolUse",
    "cut_motion",
    "find_order",
    "manipulation_of",
    "manipulation_task",
    "motion_attempts",
    "on_stand",
    "plan_back",
    "plan_gait",
    "plan_handover",
    "plan_manipulation",
    "plan_motion",
    "plan_others",
    "plan_regrasping",
    "plan_reorientation",
    "plan_single_stroke",
    "planned_ending",
]
