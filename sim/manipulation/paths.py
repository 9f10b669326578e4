"""Which path is planned for what is asked, how freely, and what tilts and translations must not do.

Turns about the vertical are what hands do best: tips roll around the object. When it is tilted or
moved, tips may have to pivot on their contacts instead.
"""

from __future__ import annotations

import math

import numpy as np

from planner.motion import MotionPlan, ObjectPath
from planner.motion.path import LARGEST_TURN, tilts
from planner.spatial import FloatArray

__all__ = ["MOST_PIVOT", "further", "narrow_tube", "pivots"]

TILT_TUBE, SHIFT_TUBE = 0.01, 0.0
"""Default radii (m) of the tube where the object is to be tilted, and where it is to be moved: it
is to get where it was asked to."""

MOST_PIVOT = math.radians(12.0)
"""Most (rad) that a tip may pivot while the object is tilted or moved. Of 15 tilts by 30 degrees
with more, boxes, cylinders and balls in both hands, 5 were made, of 24 with less all."""


def further(axis: FloatArray, angle: float, shift: FloatArray, more: float) -> ObjectPath:
    """The path with so much more of a turn than is asked for, and as much more of the translation.

    Args:
        axis: Axis of the turn (3,), world.
        angle: Turn that is asked for, rad.
        shift: Translation that is asked for (3,), m, world.
        more: rad.
    """
    if angle == 0.0:
        return ObjectPath(axis=axis, angle=0.0, shift=shift)
    turn = max(abs(angle), min(abs(angle) + more, LARGEST_TURN))
    whole = math.copysign(turn, angle)
    return ObjectPath(axis=axis, angle=whole, shift=whole / angle * shift)


def narrow_tube(axis: FloatArray, shift: FloatArray) -> float | None:
    """Radius (m) of the tube of a tilt or a translation; None for a turn about the vertical.

    Args:
        axis: Axis of the turn (3,), world.
        shift: Translation that is asked for (3,), m.
    """
    if shift.any():
        return SHIFT_TUBE
    return TILT_TUBE if tilts(axis) else None


def pivots(motion: MotionPlan) -> str:
    """Which tip pivots too far on its contact when the object is tilted or moved, "" for none.

    Torsional friction, which the controller does not know of, would hold the object up.
    """
    if not (motion.path.shift.any() or tilts(motion.path.axis)):
        return ""
    pivoted = motion.pivoted
    worst = int(np.argmax(pivoted))
    if pivoted[worst] <= MOST_PIVOT:
        return ""
    name = motion.grasp.task.finger_names[worst]
    return f"{name} pivots on its contact by {np.rad2deg(pivoted[worst]):.0f} degrees"
