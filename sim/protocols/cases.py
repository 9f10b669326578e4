"""What the protocols have in common: a case is one trial that can be sent to another process."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, TypeAlias

from planner.plan import GraspPlan
from sim.controllers import Controller
from sim.physics import PhysicsOptions
from sim.protocols.outcome import Outcome

__all__ = ["AXES", "Case", "Conditions", "MakeController"]

MakeController: TypeAlias = Callable[[GraspPlan], Controller]

AXES = ("+x", "-x", "+y", "-y", "+z", "-z")
"""Names of the six directions along the world's axes."""


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
