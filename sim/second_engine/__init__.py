"""An exported scene executed by another physics engine: a second witness of a grasp.

``hold_in_drake(folder)`` begins in Drake where the export begins, sends the commands of its key
frame "squeeze" and looks whether the object stays. Contact model, solver and their numbers are
Drake's own; ``drake_scene`` says what differs from our trials. The package is optional.
"""

from __future__ import annotations

from sim.second_engine.drake_scene import (
    INSTALL,
    TIME_STEP,
    DrakeScene,
    drake_missing,
    load_drake_scene,
)
from sim.second_engine.hold import Held, Touches, hold_in_drake

__all__ = [
    "INSTALL",
    "TIME_STEP",
    "DrakeScene",
    "Held",
    "Touches",
    "drake_missing",
    "hold_in_drake",
    "load_drake_scene",
]
