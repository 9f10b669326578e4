"""The path of an object in the hand: a turn about an axis, a translation, or both at once.

At path parameter s in [0, 1] the object has turned by s * angle about an axis through the origin of
its frame, and its origin has moved by s * shift. Axis and shift are in world axes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

import numpy as np
import pinocchio as pin

from planner.arrays import check_fields, checked_number, finite_array, float_array
from planner.errors import NotFoundError, TaskError, shown
from planner.immutable import freeze
from planner.spatial import SE3, FloatArray, rotation_angle
from planner.task import GraspTask

SHORTEST = 1e-9
"""Length (-) below which an axis has no direction; turns (rad) and shifts (m) below it are zero."""

LARGEST_TURN = np.pi
"""Largest turn (rad) of one stroke."""


UPRIGHT = 0.99
"""Least cosine (-) between the vertical and an axis that counts as vertical."""


def tilts(axis: FloatArray) -> bool:
    """Whether a turn about an axis (3,), world, of a hand with the palm down tilts the object.

    Then it stands otherwise once it is put down, palm down again, and pads that came from above
    pivot. The attitude of the turn changes nothing of that; see ``ObjectPath.weight_turns_back``.
    """
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


ATTITUDES = {
    "down": np.eye(3),
    "sideways": np.diag([1.0, 0.0, 0.0]) + np.array([[0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]]),
    "up": np.diag([1.0, -1.0, -1.0]),
}
"""Attitudes by name: the hand as it grasps from above, rolled by 90 and by 180 degrees about the
world's x axis. The heading of the grasp is the planner's to choose, so any horizontal axis is as
good for a hand whose base is free."""

AnyAttitude: TypeAlias = str | Sequence[Sequence[float]] | FloatArray
"""A name of ``ATTITUDES``, or a rotation (3, 3), world axes."""

UNTURNED, NO_ROTATION = 1e-9, 1e-6
"""Angle (rad) below which an attitude is that of the grasp; and error (-) from which on a matrix is
no rotation."""

WRIST_STEP = np.deg2rad(15.0)
"""Most (rad) that the wrist turns between two orientations at which forces are verified: gravity
changes by less than 0.13 of the weight to either side of one."""


def checked_attitude(given: AnyAttitude) -> FloatArray:
    """The rotation (3, 3), world, that an attitude is.

    Raises:
        NotFoundError: A name that is none.
        TaskError: Not a rotation.
    """
    if isinstance(given, str):
        if given not in ATTITUDES:
            raise NotFoundError("attitude", given, ATTITUDES)
        named: FloatArray = ATTITUDES[given]
        return named.copy()
    return checked_rotation("attitude", given, "a matrix with orthonormal columns, or a name")


def checked_rotation(name: str, given: Any, wanted: str) -> FloatArray:
    """A rotation (3, 3) as it was given.

    Args:
        name: What it is called.
        given: What was given.
        wanted: What to give instead, in words.

    Raises:
        TaskError: Another shape, not finite, not orthonormal, or a reflection.
    """
    turn = finite_array(name, given, (3, 3), error=TaskError)
    off = float(np.abs(turn @ turn.T - np.eye(3)).max())
    if off > NO_ROTATION or np.linalg.det(turn) < 0:
        raise TaskError(f"{name} is no rotation; give {wanted}")
    return turn


@dataclass(frozen=True, kw_only=True)
class ObjectPath:
    """The path of an object from its present pose.

    All poses and axes are those of a hand that stays as it grasped. In another attitude hand and
    object are turned as one before, so that seen from the hand gravity alone is different.

    Attributes:
        axis: (3,), unit, world.
        angle: Turn about the axis over the whole path, rad, with its sign.
        shift: Translation over the whole path (3,), m, world.
        attitude: Rotation (3, 3), world, of hand and object from the grasp to where the path is
            made.
        stays: Whether the object stays where it is in the fingers and the wrist alone turns it.
    """

    axis: FloatArray
    angle: float
    shift: FloatArray
    attitude: FloatArray = field(default_factory=lambda: np.eye(3))
    stays: bool = False

    @classmethod
    def of_wrist(cls, attitude: AnyAttitude) -> ObjectPath:
        """The path of an object that stays in the fingers while the wrist turns."""
        turn = checked_attitude(attitude)
        return cls(axis=np.eye(3)[2], angle=0.0, shift=np.zeros(3), attitude=turn, stays=True)

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
        short = abs(self.angle) < SHORTEST and float(np.linalg.norm(shift)) < SHORTEST
        if self.stays != short:
            raise TaskError(
                "the object is to stay where it is; give an angle or a shift"
                if short
                else "a path that stays has neither angle nor shift; leave them out"
            )
        object.__setattr__(self, "axis", axis / float(np.linalg.norm(axis)))
        object.__setattr__(self, "shift", shift)
        object.__setattr__(self, "angle", float(self.angle))
        object.__setattr__(self, "attitude", checked_attitude(self.attitude))
        freeze(self, arrays=("axis", "shift", "attitude"))

    def cut(self, path_parameter: float) -> ObjectPath:
        """The path up to a path parameter in (0, 1]."""
        s = path_parameter
        return replace(self, angle=s * self.angle, shift=s * self.shift)

    @property
    def wrist_turn(self) -> FloatArray:
        """Rotation vector (3,), rad, world, of the attitude; zero where the hand stays."""
        return np.asarray(pin.log3(self.attitude))

    @property
    def turns_wrist(self) -> bool:
        """Whether the path is made in another attitude than the grasp."""
        return rotation_angle(self.attitude) > UNTURNED

    @property
    def weight_turns_back(self) -> bool:
        """Whether the weight can turn the object back: the axis is not vertical in the attitude."""
        return tilts(self.attitude @ self.axis)

    def wrist(self, share: float) -> FloatArray:
        """Rotation (3, 3), world, of hand and object at a share of the way to the attitude."""
        return np.asarray(pin.exp3(share * self.wrist_turn))

    @property
    def wrist_shares(self) -> FloatArray:
        """Shares (m,) of the way to the attitude at which forces are verified, 0 with the first."""
        n = int(np.ceil(np.linalg.norm(self.wrist_turn) / WRIST_STEP - UNTURNED))
        return np.linspace(0.0, 1.0, n + 1)

    def borne(self, task: GraspTask, share: float = 1.0) -> GraspTask:
        """The task with gravity as the hand has it in the attitude, or at a share of the way."""
        if not self.turns_wrist:
            return task
        turn = self.attitude if share == 1.0 else self.wrist(share)
        return replace(task, gravity=turn.T @ task.gravity)

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
        told = " and ".join(parts) or "held as it is"
        if not self.turns_wrist:
            return told
        wrist, size = self.wrist_turn, float(np.linalg.norm(self.wrist_turn))
        about = ", ".join(f"{v:.2f}" for v in wrist / size + 0.0)
        return f"{told}, hand turned by {np.rad2deg(size):.0f} degrees about ({about})"
