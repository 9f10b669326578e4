"""Regrasping: an object is turned or moved further than one grasp allows, finger by finger."""

from planner.motion.gait.order import Lift, NoOrder, Order, find_order
from planner.motion.gait.plan import GaitPlan, Relocation, Stroke
from planner.motion.gait.regrasp import cut_motion, plan_back, plan_others
from planner.motion.gait.search import plan_gait

__all__ = [
    "GaitPlan",
    "Lift",
    "NoOrder",
    "Order",
    "Relocation",
    "Stroke",
    "cut_motion",
    "find_order",
    "plan_back",
    "plan_gait",
    "plan_others",
]
