"""Motions of an object in the hand, on one grasp: planned over knots, verified like grasps."""

from planner.motion.limits import Limit
from planner.motion.path import ObjectPath
from planner.motion.plan import Knot, MotionPlan, MotionRecord
from planner.motion.search import MotionAttempt, motion_attempts, plan_motion

__all__ = [
    "Knot",
    "Limit",
    "MotionAttempt",
    "MotionPlan",
    "MotionRecord",
    "ObjectPath",
    "motion_attempts",
    "plan_motion",
]
