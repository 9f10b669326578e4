"""What the protocols have in common: a case is one trial that can be sent to another process."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from planner.plan import GraspPlan
from planner.spatial import FloatArray
from sim.controllers import MakeController
from sim.estimation import AnyEstimator
from sim.physics import PhysicsOptions
from sim.protocols.outcome import Outcome
from sim.reality import Reality

AXES = ("+x", "-x", "+y", "-y", "+z", "-z")
"""Names of the six directions along the world's axes."""


def axis_of(i: int) -> FloatArray:
    """Unit vector (3,) of a name in ``AXES``."""
    out = np.zeros(3)
    out[i // 2] = 1.0 - 2.0 * (i % 2)
    return out


@dataclass(frozen=True, kw_only=True)
class Conditions:
    """Under which all trials of a run take place.

    Attributes:
        physics: How MuJoCo computes.
        controller: Makes what drives the hand, out of the plan.
        reality: Errors of sensors, drives and object; those of ``dexgraspbench`` and ``drake`` are
            exact whatever it is.
        estimator: What tells the controller where the object is; see ``Simulation``.
    """

    physics: PhysicsOptions
    controller: MakeController
    reality: Reality = field(default_factory=Reality)
    estimator: AnyEstimator | None = None


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
