"""A hand as controllers see it, read and write, and a loop that runs at a fixed rate.

``HandInterface`` is what a driver of a real hand must offer; ``SimulatedHand`` and ``ReplayedHand``
offer it too, and ``HandWrapper`` stands between. ``run_controller`` executes a plan on any of them.
"""

from __future__ import annotations

from sim.real_hand.interface import (
    ASSUMABLE,
    Clock,
    DryRun,
    EndOfReadings,
    HandInterface,
    HandObservation,
    HandReading,
    HandWrapper,
    Observer,
    Pace,
    PlanMark,
    RealClock,
    RecordedClock,
)
from sim.real_hand.joints import JointCheck, check_joints, checks_table, run_controller
from sim.real_hand.log import HandLog, LogWriter, read_log
from sim.real_hand.loop import Carry, ControlLoop, LoopReport, Times
from sim.real_hand.safety import (
    CommandLimiter,
    CommandLimits,
    Guard,
    OnStop,
    Safety,
    StopCause,
    Stopped,
)
from sim.real_hand.stand_ins import Comparison, ReplayedHand, SimulatedHand

__all__ = [
    "ASSUMABLE",
    "Carry",
    "Clock",
    "CommandLimiter",
    "CommandLimits",
    "Comparison",
    "ControlLoop",
    "DryRun",
    "EndOfReadings",
    "Guard",
    "HandInterface",
    "HandLog",
    "HandObservation",
    "HandReading",
    "HandWrapper",
    "JointCheck",
    "LogWriter",
    "LoopReport",
    "Observer",
    "OnStop",
    "Pace",
    "PlanMark",
    "RealClock",
    "RecordedClock",
    "ReplayedHand",
    "Safety",
    "SimulatedHand",
    "StopCause",
    "Stopped",
    "Times",
    "check_joints",
    "checks_table",
    "read_log",
    "run_controller",
]
