"""A stand: four walls in a square that carry an object above the table.

A hand that grasps from above needs room below the fingertips, 26 mm under the centre of an object
with the Shadow-type hand and 38 mm with the Allegro; balls and small blocks on a table leave less.
Round objects lie in the opening and cannot roll away, flat ones stand on the walls. Whether an
object stays as geometry puts it is for a simulation to tell (``sim.manipulation.settled``).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from planner.collision.resting import lift_to_rest
from planner.errors import TaskError
from planner.spatial import SE3, FloatArray
from planner.task import GraspTask, Obstacle

__all__ = ["on_stand"]

OPENING = 0.6
"""Inner width of the square over the smallest horizontal extent of the object (-): a ball sinks in
by a tenth of its diameter, and a block stands on the walls."""

WALL = 0.004
"""Thickness of a wall, m."""

LIFTED = 2e-6
"""How far (m) above the walls' height the highest place of the object is where it is free."""


def on_stand(task: GraspTask, height: float) -> GraspTask:
    """The task with its object on a stand on the table, which is among the obstacles.

    Args:
        task: An object that stands on a table.
        height: Of the walls, m.

    Returns:
        The task with the object straight above where it was, as low as the walls let it.

    Raises:
        TaskError: No table, a height that is not positive, or an object that does not stand on it.
    """
    if task.table_height is None:
        raise TaskError("there is no table for a stand; give table_height")
    if not (np.isfinite(height) and height > 0):
        raise TaskError(f"the stand's height is {height}; give a finite number > 0 in m")
    pose = task.T_world_object
    turn = pose.rotation
    shape = task.object.shape
    wide = [shape.support(turn.T @ axis) + shape.support(-turn.T @ axis) for axis in np.eye(3)[:2]]
    inner = OPENING * min(wide)
    x, y = pose.translation[:2]
    walls = tuple(_walls(inner, height, np.array([x, y, task.table_height])))
    lift = lift_to_rest(shape, pose, walls, 0.0, height + LIFTED)
    if lift is None:
        raise TaskError(
            f"the object is in the walls of a stand even {1e3 * height:.0f} mm above the table; "
            "give its pose with its lowest point on the table"
        )
    lifted = SE3(pose.rotation, pose.translation + np.array([0.0, 0.0, lift]))
    return replace(task, T_world_object=lifted, obstacles=walls)


def _walls(inner: float, height: float, foot: FloatArray) -> list[Obstacle]:
    """Four boxes around a square opening above ``foot`` (3,)."""
    away = (inner + WALL) / 2
    out = []
    for name, axis, sign in (("+x", 0, 1), ("-x", 0, -1), ("+y", 1, 1), ("-y", 1, -1)):
        center = np.array([0.0, 0.0, height / 2])
        center[axis] = sign * away
        size = np.array([0.0, 0.0, height])
        size[axis], size[1 - axis] = WALL, inner + 2 * WALL if axis == 0 else inner
        out.append(
            Obstacle(
                name=f"stand {name}", size=size, T_world_obstacle=SE3(np.eye(3), foot + center)
            )
        )
    return out
