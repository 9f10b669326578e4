"""Learned manipulation: policies by imitation of the planner's closed loop, by joints and touch.

``sim.learning.environment`` has the Gymnasium environment; it needs ``opposable[learn]``, as
training does. Running a policy needs nothing more than NumPy.
"""

from __future__ import annotations

from sim.learning.controller import (
    PolicyController,
    PolicyMaker,
    named_driver,
    open_loop,
    policy_controller,
    shipped_policies,
)
from sim.learning.policy import Policy, PolicyFor
from sim.learning.senses import ObjectRange
from sim.learning.training import Course, Learned, Progress, learn
from sim.learning.trials import Conditions, Plans, TurnTask

__all__ = [
    "Conditions",
    "Course",
    "Learned",
    "ObjectRange",
    "Plans",
    "Policy",
    "PolicyController",
    "PolicyFor",
    "PolicyMaker",
    "Progress",
    "TurnTask",
    "learn",
    "named_driver",
    "open_loop",
    "policy_controller",
    "shipped_policies",
]
