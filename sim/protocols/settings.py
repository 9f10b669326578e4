"""``Settings``: the numbers of the protocols that are ours, each with its reason."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from planner.errors import TaskError
from sim.protocols.disturbance import DROPPED
from sim.verdict import DropCriteria

__all__ = ["Settings"]


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Numbers of the protocols but ``dexgraspbench``, which has its own.

    Attributes:
        hold_s: How long each direction of gravity is held, s: as long as DexGraspBench's push.
        growth: Factor from one load to the next (-): the resolution of a breaking magnitude.
        step_s: How long each load lasts, s, the first half of which leads up to it: a servo comes
            to rest in 0.1 s.
        first_load: Of the object's weight under 9.81 m/s2, the first load (-).
        most_load: The same, the last one (-): nothing that fingers hold bears more.
        random: Random directions of wrench.
        shake_mm: Amplitude of shaking along an axis, mm; with 5 Hz it is 1 g.
        shake_deg: Amplitude about an axis, degrees; 0.9 g at 0.1 m from the hand's base.
        shake_hz: Frequency, 1/s.
        shake_s: Duration, s.
        mass_factors: Of the object's mass (-).
        friction_factors: Of the friction in simulation (-).
        pose_errors: How far the object is from where the plan has it, pairs of mm and degrees, in a
            random direction each.
        realities: Draws of the protocol ``reality``.
        pushes: Holds of the protocol ``pushes``.
        pushes_s: Duration of each, s.
        push_load: Of the object's weight under 9.81 m/s2, the strongest push (-).
        dropped: When an object counts as lost.
    """

    hold_s: float = 2.0
    growth: float = 1.1
    step_s: float = 0.15
    first_load: float = 0.5
    most_load: float = 200.0
    random: int = 20
    shake_mm: float = 10.0
    shake_deg: float = 5.0
    shake_hz: float = 5.0
    shake_s: float = 2.0
    mass_factors: tuple[float, ...] = (0.5, 1.0, 2.0)
    friction_factors: tuple[float, ...] = (0.7, 1.0, 1.3)
    pose_errors: tuple[tuple[float, float], ...] = ((0.0, 0.0), (2.5, 2.5), (5.0, 5.0))
    realities: int = 10
    pushes: int = 3
    pushes_s: float = 60.0
    push_load: float = 1.5
    dropped: DropCriteria = DROPPED

    def __post_init__(self) -> None:
        """Check every number."""
        for item in fields(self):
            value = getattr(self, item.name)
            if isinstance(value, float) and not (np.isfinite(value) and value > 0):
                raise TaskError(f"{item.name} is {value}; give a finite number > 0")
        if self.growth <= 1:
            raise TaskError(f"growth is {self.growth}; loads grow by a factor above 1")
        if self.random < 0:
            raise TaskError(f"random is {self.random}; give a number of directions >= 0")
        if self.realities < 1:
            raise TaskError(f"realities is {self.realities}; give a number of draws >= 1")
        if self.pushes < 1:
            raise TaskError(f"pushes is {self.pushes}; give a number of holds >= 1")
        factors = (*self.mass_factors, *self.friction_factors)
        if not factors or not all(np.isfinite(f) and f > 0 for f in factors):
            raise TaskError(f"factors of mass and friction are {factors}; give numbers > 0")
        if not all(np.isfinite(e) and e >= 0 for pair in self.pose_errors for e in pair):
            raise TaskError(f"pose errors are {self.pose_errors}; give mm and degrees >= 0")
