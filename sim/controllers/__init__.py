"""Controllers: what turns observations of a trial into commands for the hand's actuators."""

from __future__ import annotations

from typing import TYPE_CHECKING

from planner.system.package import lazy_names
from sim.controllers.base import (
    PHASES,
    Controller,
    Event,
    EventKind,
    HasOwnAim,
    NeedsSenses,
    Observation,
    PadReading,
    Phase,
    Recloses,
    Reference,
    Refuses,
    ReportsEvents,
    ReportsLimits,
    Sense,
    Target,
    TouchReading,
    UsesSenses,
)
from sim.controllers.grasp import GraspController
from sim.controllers.named import (
    CONTROLLERS,
    AnyController,
    MakeController,
    controller_for,
    controller_maker,
    controller_name,
    named_controller,
)

if TYPE_CHECKING:
    from sim.controllers.follow import MotionReference
    from sim.controllers.impedance import ImpedanceGains
    from sim.controllers.monitors import SlipDetector
    from sim.controllers.object_impedance import ObjectImpedance

__all__ = [
    "CONTROLLERS",
    "PHASES",
    "AnyController",
    "Controller",
    "Event",
    "EventKind",
    "GraspController",
    "HasOwnAim",
    "ImpedanceGains",
    "MakeController",
    "MotionReference",
    "NeedsSenses",
    "ObjectImpedance",
    "Observation",
    "PadReading",
    "Phase",
    "Recloses",
    "Reference",
    "Refuses",
    "ReportsEvents",
    "ReportsLimits",
    "Sense",
    "SlipDetector",
    "Target",
    "TouchReading",
    "UsesSenses",
    "controller_for",
    "controller_maker",
    "controller_name",
    "named_controller",
]

_HOMES = {
    "ImpedanceGains": "sim.controllers.impedance",
    "MotionReference": "sim.controllers.follow",
    "ObjectImpedance": "sim.controllers.object_impedance",
    "SlipDetector": "sim.controllers.monitors",
}
"""What the usual trial does not need -> the module that defines it."""

__getattr__, __dir__ = lazy_names(__name__, _HOMES)
