"""Reality: errors of sensors, drives and object that planner and controller do not know."""

from sim.reality.drawn import Drawn, drawn_numbers, draws_in_words
from sim.reality.errors import (
    IDEAL,
    LAB,
    REALITIES,
    ROUGH,
    AnyReality,
    Reality,
    named_reality,
    register_reality,
)
from sim.reality.trial import RealityOfTrial

__all__ = [
    "IDEAL",
    "LAB",
    "REALITIES",
    "ROUGH",
    "AnyReality",
    "Drawn",
    "Reality",
    "RealityOfTrial",
    "drawn_numbers",
    "draws_in_words",
    "named_reality",
    "register_reality",
]
