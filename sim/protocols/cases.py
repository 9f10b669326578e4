"""What the protocols have in common: a case is one trial that can be sent to another process."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, TypeAlias

from planner.errors import NotFoundError
from planner.plan import GraspPlan
from sim.controllers import Controller, GraspController
from sim.physics import PhysicsOptions
from sim.protocols.outcome import Outcome

__all__ = ["AXES", "CONTROLLERS", "Case", "Conditions", "MakeController", "controller_of"]

MakeController: TypeAlias = Callable[[GraspPlan], Controller]

AXES = ("+x", "-x", "+y", "-y", "+z", "-z")
"""Names of the six directions along the world's axes."""

CONTROLLERS: dict[str, MakeController] = {"open": GraspController}
"""Controllers by the names that the command line gives them."""


@dataclass(frozen=True, kw_only=True)
class Conditions:
    """Under which all trials of a run take place.

    Attributes:
        physics: How MuJoCo computes.
        controller: Makes what drives the hand, out of the plan.
    """

    physics: PhysicsOptions
    controller: MakeController


class Case(Protocol):
    """One trial of a protocol: plain data."""

    @property
    def index(self) -> int:
        """Its number."""
        ...

    @property
    def name(self) -> str:
        """What it is called."""
        ...

    def run(self, plan: GraspPlan, conditions: Conditions) -> Outcome:
        """Execute it."""
        ...


def controller_of(name: str) -> MakeController:
    """What makes the controller of a name.

    Raises:
        NotFoundError: There is none.
    """
    if name not in CONTROLLERS:
        raise NotFoundError("controller", name, list(CONTROLLERS))
    return CONTROLLERS[name]
