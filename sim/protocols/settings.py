"""``Settings``: the numbers of the protocols that are ours, each with its reason."""

from __future__ import annotations

from dataclasses import dataclass, fields

from planner.arrays import check_fields, checked_number, finite_array
from planner.errors import TaskError
from sim.protocols.disturbance import DROPPED
from sim.verdict import DropCriteria


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
        numbers = [f.name for f in fields(self) if str(f.type).startswith(("float", "tuple[float"))]
        check_fields(self, numbers, above=0.0)
        check_fields(self, ("growth",), above=1.0)
        check_fields(self, ("random",))
        check_fields(self, ("realities", "pushes"), least=1)
        if not self.mass_factors or not self.friction_factors:
            raise TaskError("there are no factors of mass or friction; give at least one of each")
        for errors in self.pose_errors:
            for size in finite_array("pose_errors", errors, (2,), error=TaskError).tolist():
                checked_number("pose_errors", size, least=0.0, unit="mm, deg", error=TaskError)
