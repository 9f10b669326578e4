"""Wrenches that a grasp should resist: given by the user, or ready-made for common cases.

A task wrench acts on the object about its centre of mass, in the object's frame, [N; N m].
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from planner.errors import TaskError, shown
from planner.spatial import FloatArray
from planner.task import GraspTask

_GOLDEN = (1 + 5**0.5) / 2
_ICOSAHEDRON: FloatArray = np.array(
    [
        np.roll([0.0, a, b * _GOLDEN], shift)
        for shift in range(3)
        for a in (1.0, -1.0)
        for b in (1.0, -1.0)
    ]
)
"""Corners (12, 3) of a regular icosahedron with edges of length 2."""

_INRADIUS = _GOLDEN**2 / 3**0.5
"""Radius of the ball that touches its faces from within."""


def gravity_any_direction(task: GraspTask) -> FloatArray:
    """The object's weight in any direction, (12, 6), N: corners of an icosahedron around its ball.

    The set of resisted wrenches is convex: a grasp that resists the corners resists every weight
    inside. The corners are 1.26 times as heavy as the object. Without gravity they are those of one
    newton.
    """
    weight = task.object.mass * float(np.linalg.norm(task.gravity)) or 1.0
    forces = weight / _INRADIUS * _ICOSAHEDRON
    return np.hstack([forces, np.zeros_like(forces)])


def tool_torque(axis: ArrayLike, torque: float) -> FloatArray:
    """A torque about an axis of the object's frame, both ways round, (2, 6), N m.

    Args:
        axis: Direction (3,), any length but zero.
        torque: N m, > 0.

    Raises:
        TaskError: The axis has no direction, or the torque is not positive.
    """
    direction = np.asarray(axis, dtype=np.float64)
    size = float(np.linalg.norm(direction))
    if direction.shape != (3,) or not np.isfinite(size) or size == 0.0:
        raise TaskError(
            f"the axis of a tool's torque is {shown(axis)}; give three numbers, not all 0"
        )
    if not (np.isfinite(torque) and torque > 0):
        raise TaskError(f"a tool's torque is {torque}; give N m > 0")
    turn = np.concatenate([np.zeros(3), torque * direction / size])
    return np.stack([turn, -turn])


def resisted_wrenches(task: GraspTask, wrenches: ArrayLike = ()) -> FloatArray:
    """The task wrenches (k, 6): those given, else the weight in any direction.

    Raises:
        TaskError: As ``checked_wrenches`` does.
    """
    if given := checked_wrenches(wrenches if wrenches is not None else ()):
        return np.array(given)
    return gravity_any_direction(task)


def checked_wrenches(
    wrenches: ArrayLike,
) -> tuple[tuple[float, ...], ...]:
    """Task wrenches (k, 6) as plain numbers, after a check; k may be 0.

    Raises:
        TaskError: Another shape, NaN or infinity, or a wrench of nothing but zeros.
    """
    try:
        array = np.array(wrenches, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise TaskError(f"task_wrenches is {shown(wrenches)}; {_FORM}") from error
    if array.size == 0:
        return ()
    if array.ndim != 2 or array.shape[1] != 6 or not np.isfinite(array).all():
        raise TaskError(f"task_wrenches has shape {array.shape} or holds NaN; {_FORM}")
    if not np.abs(array).max(axis=1).all():
        raise TaskError(f"a task wrench is zero in all components; {_FORM}")
    return tuple(tuple(float(v) for v in row) for row in array)


_FORM = "give rows of six finite numbers, fx, fy, fz in N and tx, ty, tz in N m, object frame"
