"""The path of an object in the hand: a turn about an axis, a translation, or both at once.

At path parameter s in [0, 1] the object has turned by s * angle about an axis through the origin of
its frame, and its origin has moved by s * shift. Axis and shift are in world axes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from planner.arrays import check_fields, checked_number, finite_array, float_array
from planner.errors import TaskError, shown
from planner.immutable import freeze
from planner.spatial import SE3, FloatArray

SHORTEST = 1e-9
"""Length (-) below which an axis has no direction; turns (rad) and shifts (m) below it are zero."""

LARGEST_TURN = np.pi
"""Largest turn (rad) of one stroke."""


UPRIGHT = 0.99
"""Least cosine (-) between the vertical and an axis that counts as vertical."""


def tilts(axis: FloatArray) -> bool:
    """Whether a turn about an axis (3,), world, tilts the object."""
    return bool(abs(axis[2]) < UPRIGHT * np.linalg.norm(axis))


LONGEST_SHIFT = 2.0
"""Longest translation, m: far beyond the reach of fingers that keep their contacts."""


FARTHEST = 100.0
"""Largest coordinate (m) of a place to stand at: beyond it poses lose digits."""


def checked_axis(axis: Any) -> FloatArray:
    """An axis (3,), world, as it was given.

    Raises:
        TaskError: Another shape, not finite, or without a direction.
    """
    array = float_array("axis", axis, error=TaskError, copy=True)
    length = float(np.linalg.norm(array)) if array.shape == (3,) else 0.0
    if not (np.isfinite(length) and length > SHORTEST):
        raise TaskError(f"axis is {shown(axis)}; give a direction of three numbers in world axes")
    return array


def check_place(place: Any) -> None:
    """Refuse a place, x and y in m, that is not two numbers within ``FARTHEST``; None is none.

    Raises:
        TaskError: So.
    """
    if place is not None:
        for number in finite_array("place", place, (2,), error=TaskError).tolist():
            checked_number("place", number, least=-FARTHEST, most=FARTHEST, error=TaskError)


def checked_shift(given: Any) -> FloatArray:
    """A shift (3,), m, that an object can make in a hand.

    Raises:
        TaskError: Another shape, not finite, or longer than ``LONGEST_SHIFT``.
    """
    shift = finite_array("shift", given, (3,), error=TaskError)
    if np.abs(shift).max() > LONGEST_SHIFT or np.linalg.norm(shift) > LONGEST_SHIFT:
        raise TaskError(f"shift is {shift}; give a translation of at most {LONGEST_SHIFT:g} m")
    return shift


@dataclass(frozen=True, kw_only=True)
class ObjectPath:
    """The path of an object from its present pose.

    Attributes:
        axis: (3,), unit, world.
        angle: Turn about the axis over the whole path, rad, with its sign.
        shift: Translation over the whole path (3,), m, world.
    """

    axis: FloatArray
    angle: float
    shift: FloatArray

    def __post_init__(self) -> None:
        """Check the numbers, and make the axis a unit vector.

        Raises:
            TaskError: No axis, numbers that are not finite, or a path that is empty or too long.
        """
        axis, shift = checked_axis(self.axis), checked_shift(self.shift)
        check_fields(self, ("angle",), unit="rad")
        if abs(self.angle) > LARGEST_TURN + SHORTEST:
            raise TaskError(
                f"angle is {self.angle} rad; give at most a half turn (pi) in either direction, "
                "since the fingers stay where they touch"
            )
        if abs(self.angle) < SHORTEST and float(np.linalg.norm(shift)) < SHORTEST:
            raise TaskError("the object is to stay where it is; give an angle or a shift")
        object.__setattr__(self, "axis", axis / float(np.linalg.norm(axis)))
        object.__setattr__(self, "shift", shift)
        object.__setattr__(self, "angle", float(self.angle))
        freeze(self, arrays=("axis", "shift"))

    def cut(self, path_parameter: float) -> ObjectPath:
        """The path up to a path parameter in (0, 1]."""
        s = path_parameter
        return ObjectPath(axis=self.axis, angle=s * self.angle, shift=s * self.shift)

    def pose(self, T_world_start: SE3, path_parameter: float) -> SE3:
        """Pose of the object at a path parameter; the path begins at ``T_world_start``."""
        s = path_parameter
        turn = pin.exp3(s * self.angle * self.axis)
        return SE3(turn @ T_world_start.rotation, T_world_start.translation + s * self.shift)

    def __str__(self) -> str:
        """Turn and translation in words."""
        parts = []
        if abs(self.angle) >= SHORTEST:
            axis = ", ".join(f"{v:.3g}" for v in self.axis + 0.0)
            parts.append(f"{np.rad2deg(self.angle):.1f} degrees about ({axis})")
        if float(np.linalg.norm(self.shift)) >= SHORTEST:
            parts.append(f"({', '.join(f'{1e3 * v:.1f}' for v in self.shift)}) mm")
        return " and ".join(parts)
