"""Reality: errors of sensors, drives and object that planner and controller do not know."""

from typing import TYPE_CHECKING

from planner.system.package import lazy_names
from sim.sensing.reality.drawn import Drawn, drawn_numbers, drawn_text
from sim.sensing.reality.errors import (
    IDEAL,
    LAB,
    REALITIES,
    ROUGH,
    AnyReality,
    Reality,
    named_reality,
    register_reality,
)

if TYPE_CHECKING:
    from sim.sensing.reality.trial import RealityOfTrial

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
    "drawn_text",
    "named_reality",
    "register_reality",
]

# a trial without errors needs none of it, nor of touch
__getattr__, __dir__ = lazy_names(__name__, {"RealityOfTrial": "sim.sensing.reality.trial"})
