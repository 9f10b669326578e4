"""Controllers: what turns observations of a trial into commands for the hand's actuators."""

from __future__ import annotations

from sim.controllers.base import (
    PHASES,
    Controller,
    Observation,
    Phase,
    ReportsEvents,
    ReportsLimits,
)
from sim.controllers.events import Event, EventKind
from sim.controllers.grasp import GraspController
from sim.controllers.pads import PadReading

__all__ = [
    "PHASES",
    "Controller",
    "Event",
    "EventKind",
    "GraspController",
    "Observation",
    "PadReading",
    "Phase",
    "ReportsEvents",
    "ReportsLimits",
]
