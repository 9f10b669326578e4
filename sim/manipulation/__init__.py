"""Pick, turn in the hand, place: planned, executed phase by phase, and judged."""

from __future__ import annotations

from sim.manipulation.checks import Check
from sim.manipulation.pace import IN_THE_AIR, STEPS, Bounds, Pace, Step
from sim.manipulation.report import ManipulationReport
from sim.manipulation.run import ManipulationRun, manipulate
from sim.manipulation.samples import Track
from sim.manipulation.stage import Push
from sim.manipulation.standing import rests, settled

__all__ = [
    "IN_THE_AIR",
    "STEPS",
    "Bounds",
    "Check",
    "ManipulationReport",
    "ManipulationRun",
    "Pace",
    "Push",
    "Step",
    "Track",
    "manipulate",
    "rests",
    "settled",
]
