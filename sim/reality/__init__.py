"""Reality: errors of sensors, drives and object that planner and controller do not know."""

from sim.reality.drawn import Drawn
from sim.reality.errors import IDEAL, REALITIES, Reality, register_reality
from sim.reality.named import (
    AnyReality,
    as_reality,
    named_reality,
    read_reality,
    reality_for,
)
from sim.reality.presets import ideal, lab, rough
from sim.reality.trial import RealityOfTrial
from sim.reality.words import drawn_numbers, draws_in_words

__all__ = [
    "IDEAL",
    "REALITIES",
    "AnyReality",
    "Drawn",
    "Reality",
    "RealityOfTrial",
    "as_reality",
    "drawn_numbers",
    "draws_in_words",
    "ideal",
    "lab",
    "named_reality",
    "read_reality",
    "reality_for",
    "register_reality",
    "rough",
]
