"""Controllers: what turns observations of a trial into commands for the hand's actuators."""

from __future__ import annotations

from sim.controllers.base import PHASES, Controller, Observation, Phase, ReportsLimits
from sim.controllers.grasp import GraspController

__all__ = ["PHASES", "Controller", "GraspController", "Observation", "Phase", "ReportsLimits"]
