"""A hand as controllers see it, read and write, and a loop that runs at a fixed rate.

``HandInterface`` is what a driver of a real hand must offer; ``SimulatedHand`` and ``ReplayedHand``
offer it too, and ``HandWrapper`` stands between. ``run_controller`` executes a plan on any of them.
"""

from __future__ import annotations

from sim.real_hand.clock import Clock, Pace, RealClock, RecordedClock
from sim.real_hand.interface import (
    DryRun,
    EndOfReadings,
    HandInterface,
    HandReading,
    HandWrapper,
)
from sim.real_hand.joints import JointCheck, check_joints, checks_table
from sim.real_hand.limits import CommandLimiter, CommandLimits
from sim.real_hand.log import HandLog, LogWriter, read_log
from sim.real_hand.loop import Carry, ControlLoop
from sim.real_hand.packets import Inbox, LossyLink, Packet, reading_of, reading_values
from sim.real_hand.plan_mark import PlanMark
from sim.real_hand.replay import Comparison, ReplayedHand
from sim.real_hand.report import LoopReport, Times
from sim.real_hand.run import run_controller
from sim.real_hand.safety import Guard, OnStop, Safety, StopCause, Stopped
from sim.real_hand.senses import ASSUMABLE, HandObservation, Observer
from sim.real_hand.simulated import SimulatedHand
from sim.real_hand.udp import UdpHand

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
    "Inbox",
    "JointCheck",
    "LogWriter",
    "LoopReport",
    "LossyLink",
    "Observer",
    "OnStop",
    "Pace",
    "Packet",
    "PlanMark",
    "RealClock",
    "RecordedClock",
    "ReplayedHand",
    "Safety",
    "SimulatedHand",
    "StopCause",
    "Stopped",
    "Times",
    "UdpHand",
    "check_joints",
    "checks_table",
    "read_log",
    "reading_of",
    "reading_values",
    "run_controller",
]
