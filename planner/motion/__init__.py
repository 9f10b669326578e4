"""Movements of an object in the hand: searched over knots, verified like grasps, phase by phase."""

from planner.motion.path import ObjectPath
from planner.motion.plan import Knot, Limit, MotionPlan, MotionRecord, MovementPlan
from planner.motion.search import MotionAttempt, motion_attempts, plan_motion

__all__ = [
    "Knot",
    "Limit",
    "MotionAttempt",
    "MotionPlan",
    "MotionRecord",
    "MovementPlan",
    "ObjectPath",
    "motion_attempts",
    "plan_motion",
]
