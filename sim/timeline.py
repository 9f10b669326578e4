"""``Timeline``: how long the phases of a trial take."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from planner.arrays import check_fields
from planner.spatial import minimum_jerk
from sim.controllers.base import PHASES

__all__ = ["Timeline"]


@dataclass(frozen=True, kw_only=True)
class Timeline:
    """How long each phase takes, in s, and how far the lift goes.

    Attributes:
        approach: From the start pose straight to the grasp pose, fingers at the pre-grasp.
        close: Fingers from pre-grasp to grasp.
        close_wait: Longest further wait for fingers that do not touch yet.
        squeeze: From first touch to the planned forces.
        settle: Full forces, before the lift; slip counts from its beginning.
        lift: Upwards by ``lift_height``.
        hold: Held in the air.
        lift_height: m.
    """

    approach: float = 1.0
    close: float = 0.5
    close_wait: float = 1.0
    squeeze: float = 0.6
    settle: float = 0.2
    lift: float = 1.0
    hold: float = 2.0
    lift_height: float = 0.1

    def __post_init__(self) -> None:
        """Check that every phase has a duration."""
        check_fields(self, ("close_wait",), what="timeline: ", least=0.0)
        phases = [field.name for field in fields(self) if field.name != "close_wait"]
        check_fields(self, phases, what="timeline: ", above=0.0)

    @classmethod
    def quick(cls, **changes: float) -> Timeline:
        """Shorter phases, for many trials that nobody looks at.

        Args:
            changes: Durations by name, s, that are to be others.
        """
        durations = {
            "approach": 0.3,
            "close": 0.3,
            "close_wait": 0.3,
            "squeeze": 0.4,
            "lift": 0.5,
            "hold": 1.0,
        }
        return cls(**(durations | changes))

    @property
    def duration(self) -> float:
        """Nominal duration without waiting, s."""
        return float(sum(getattr(self, phase) for phase in PHASES))

    @staticmethod
    def profile(share: float) -> tuple[float, float]:
        """How far a motion is at a share of its time, and the derivative: at rest at both ends."""
        return float(minimum_jerk(np.asarray(share))), 30.0 * share**2 * (1.0 - share) ** 2
