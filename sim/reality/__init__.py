"""Reality: errors of sensors, drives and object that planner and controller do not know."""

from sim.reality.drawn import Drawn
from sim.reality.errors import IDEAL, REALITIES, Reality, named_reality, register_reality
from sim.reality.presets import ideal, lab, rough
from sim.reality.trial import RealityOfTrial

__all__ = [
    "IDEAL",
    "REALITIES",
    "Drawn",
    "Reality",
    "RealityOfTrial",
    "ideal",
    "lab",
    "named_reality",
    "register_reality",
    "rough",
]
