"""Reality: errors of sensors, drives and object that planner and controller do not know."""

from typing import TYPE_CHECKING

from planner.system.lazy_names import lazy_names
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
from sim.reality.words import drawn_numbers, draws_in_words

if TYPE_CHECKING:
    from sim.reality.trial import RealityOfTrial

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

# a trial without errors needs none of it, nor of touch
__getattr__, __dir__ = lazy_names(__name__, {"RealityOfTrial": "sim.reality.trial"})
