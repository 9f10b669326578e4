"""Pick, turn in the hand, place: executed phase by phase, and judged."""

from __future__ import annotations

from sim.manipulation.in_hand import (
    InHandController,
    ManipulationObservation,
    TurningController,
)
from sim.manipulation.log import ManipulationLog
from sim.manipulation.report import ManipulationReport
from sim.manipulation.report_file import ManipulationReportFile, read_manipulation_report
from sim.manipulation.run import ManipulationRun, manipulate
from sim.manipulation.simulation import ManipulationOptions, ManipulationSim, Push
from sim.manipulation.standing import rests, settled
from sim.manipulation.timeline import (
    IN_THE_AIR,
    PHASES,
    ManipulationPhase,
    ManipulationTimeline,
    SuccessCriteria,
)
from sim.report import PhaseResult

__all__ = [
    "IN_THE_AIR",
    "PHASES",
    "InHandController",
    "ManipulationLog",
    "ManipulationObservation",
    "ManipulationOptions",
    "ManipulationPhase",
    "ManipulationReport",
    "ManipulationReportFile",
    "ManipulationRun",
    "ManipulationSim",
    "ManipulationTimeline",
    "PhaseResult",
    "Push",
    "SuccessCriteria",
    "TurningController",
    "manipulate",
    "read_manipulation_report",
    "rests",
    "settled",
]
