"""Regrasping: an object is turned or moved further than one grasp allows, finger by finger."""

from planner.gait.back import cut_motion, plan_back, plan_others
from planner.gait.order import Lift, NoOrder, Order, find_order
from planner.gait.plan import GaitPlan, Relocation, Stroke
from planner.gait.search import plan_gait

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
