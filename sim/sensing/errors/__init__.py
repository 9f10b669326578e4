"""ErrorModel: errors of sensors, drives and object that planner and controller do not know."""

from typing import TYPE_CHECKING

from planner.system.package import lazy_names
from sim.sensing.errors.model import (
    ERROR_MODELS,
    IDEAL,
    LAB,
    ROUGH,
    AnyErrorModel,
    Drawn,
    ErrorModel,
    drawn_numbers,
    drawn_text,
    named_errors,
    register_errors,
)

if TYPE_CHECKING:
    from sim.sensing.errors.trial import TrialErrors

__all__ = [
    "ERROR_MODELS",
    "IDEAL",
    "LAB",
    "ROUGH",
    "AnyErrorModel",
    "Drawn",
    "ErrorModel",
    "TrialErrors",
    "drawn_numbers",
    "drawn_text",
    "named_errors",
    "register_errors",
]

# a trial without errors needs none of it, nor of touch
__getattr__, __dir__ = lazy_names(__name__, {"TrialErrors": "sim.sensing.errors.trial"})
