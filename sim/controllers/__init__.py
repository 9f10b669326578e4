"""Controllers: what turns observations of a trial into commands for the hand's actuators."""

from __future__ import annotations

from sim.controllers.base import (
    PHASES,
    Controller,
    Event,
    EventKind,
    HasOwnAim,
    NeedsSenses,
    Observation,
    Phase,
    Recloses,
    Reference,
    Refuses,
    ReportsEvents,
    ReportsLimits,
    Sense,
    Target,
    UsesSenses,
)
from sim.controllers.follow import MotionReference
from sim.controllers.grasp import GraspController
from sim.controllers.impedance import ImpedanceGains
from sim.controllers.monitors import SlipDetector
from sim.controllers.named import (
    CONTROLLERS,
    AnyController,
    MakeController,
    controller_for,
    controller_maker,
    controller_name,
    named_controller,
)
from sim.controllers.object_impedance import ObjectImpedance
from sim.controllers.readings import PadReading, TouchReading

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
