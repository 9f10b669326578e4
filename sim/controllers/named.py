"""Controllers by the names that commands and reports use."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

from planner.errors import NotFoundError
from planner.plan import GraspPlan
from sim.controllers.base import Controller
from sim.controllers.closed import ObjectImpedance
from sim.controllers.grasp import GraspController

__all__ = ["CONTROLLERS", "named_controller"]

CONTROLLERS: Mapping[str, Callable[[GraspPlan], Controller]] = MappingProxyType(
    {"open": GraspController, "closed": ObjectImpedance}
)
"""open: the planned forces, turned with the object, and servos that hold the posture, but nothing
that steers the object; closed: the loop that keeps the object's pose."""


def named_controller(name: str) -> Callable[[GraspPlan], Controller]:
    """What makes a fresh controller for a plan.

    Raises:
        NotFoundError: No controller has that name.
    """
    if name not in CONTROLLERS:
        raise NotFoundError("controller", name, CONTROLLERS)
    return CONTROLLERS[name]
