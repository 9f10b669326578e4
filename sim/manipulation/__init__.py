"""Pick, turn in the hand, place: planned, executed phase by phase, and judged."""

from __future__ import annotations

from sim.manipulation.checks import Check
from sim.manipulation.gaits import plan_regrasping, plan_turning
from sim.manipulation.pace import IN_THE_AIR, STEPS, Bounds, Pace, Step
from sim.manipulation.plan import ManipulationPlan, plan_manipulation
from sim.manipulation.report import ManipulationReport
from sim.manipulation.rounds import manipulation_task
from sim.manipulation.run import ManipulationRun, manipulate
from sim.manipulation.samples import Track
from sim.manipulation.stage import Push

__all__ = [
    "IN_THE_AIR",
    "STEPS",
    "Bounds",
    "Check",
    "ManipulationPlan",
    "ManipulationReport",
    "ManipulationRun",
    "Pace",
    "Push",
    "Step",
    "Track",
    "manipulate",
    "manipulation_task",
    "plan_manipulation",
    "plan_regrasping",
    "plan_turning",
]
