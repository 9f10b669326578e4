"""Read-only poses and arrays, for tasks and plans.

Caches are keyed by tasks, so a task must not change when its caller goes on with the pose that he
gave.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pinocchio as pin

from planner.spatial import SE3, FloatArray, fixed_array

__all__ = ["FixedPose", "fixed_pose", "freeze", "is_pose"]


class FixedPose(SE3):  # type: ignore[misc]
    """A read-only ``pinocchio.SE3``, held by tasks and plans.

    It is accepted wherever a pose is, and products with it are plain ``SE3``.
    ``SE3(pose)`` is a copy that can be changed.
    """

    _translation: FloatArray
    _rotation: FloatArray

    @property
    def translation(self) -> FloatArray:
        """(3,), m; read-only."""
        try:
            return self._translation
        except AttributeError:
            self._translation = fixed_array(SE3.translation.fget(self))
            return self._translation

    @property
    def rotation(self) -> FloatArray:
        """(3, 3); read-only."""
        try:
            return self._rotation
        except AttributeError:
            self._rotation = fixed_array(SE3.rotation.fget(self))
            return self._rotation

    def __reduce__(self) -> tuple[type[FixedPose], tuple[FloatArray, FloatArray]]:
        """How it is pickled: by its numbers."""
        return FixedPose, (np.array(self.rotation), np.array(self.translation))

    def setIdentity(self) -> None:
        """Refused.

        Raises:
            AttributeError: Always.
        """
        raise AttributeError(CHANGE_A_COPY)

    def setRandom(self) -> None:
        """Refused.

        Raises:
            AttributeError: Always.
        """
        raise AttributeError(CHANGE_A_COPY)


CHANGE_A_COPY = "this pose belongs to a task or a plan; change a copy of it: pinocchio.SE3(pose)"
"""Message of the refusal to change a ``FixedPose``."""


def fixed_pose(pose: SE3) -> FixedPose:
    """A read-only copy of a pose; the pose itself if it is read-only already."""
    return pose if isinstance(pose, FixedPose) else FixedPose(pose)


def is_pose(value: object) -> bool:
    """Whether a value is a ``pinocchio.SE3``."""
    return isinstance(value, pin.SE3)


def freeze(holder: object, *, poses: Iterable[str] = (), arrays: Iterable[str] = ()) -> None:
    """Replace a frozen dataclass's poses and arrays by read-only copies.

    Args:
        holder: A frozen dataclass.
        poses: Names of attributes that are poses.
        arrays: Names of attributes that are arrays of numbers.
    """
    for name in poses:
        object.__setattr__(holder, name, fixed_pose(getattr(holder, name)))
    for name in arrays:
        object.__setattr__(holder, name, fixed_array(getattr(holder, name)))
