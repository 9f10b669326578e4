"""A stand: four walls in a square that carry an object above the table.

A hand that grasps from above needs room below the fingertips, 26 mm under the centre of an object
with the Shadow-type hand and 38 mm with the Allegro; balls and small blocks on a table leave less.
Round objects lie in the opening and cannot roll away, flat ones stand on the walls.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from planner.collision import shape_pair
from planner.errors import TaskError
from planner.shapes import Box
from planner.spatial import SE3, FloatArray
from planner.task import GraspTask, Obstacle

__all__ = ["on_stand"]

OPENING = 0.6
"""Inner width of the square over the smallest horizontal extent of the object (-): a ball sinks in
by a tenth of its diameter, and a block stands on the walls."""

WALL = 0.004
"""Thickness of a wall, m."""

APART = 1e-6
"""Distance (m) from the walls at which the object lies on them; it must not be in them."""

HALVINGS = 20
"""Halvings of the height at which it may lie: a few centimetres to less than a micrometre."""


def on_stand(task: GraspTask, height: float) -> GraspTask:
    """The task with its object on a stand on the table, which is among the obstacles.

    Args:
        task: An object that stands on a table.
        height: Of the walls, m.

    Raises:
        TaskError: No table, or a height that is not positive.
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
    return replace(task, T_world_object=_lowered(task, walls, height), obstacles=walls)


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


def _lowered(task: GraspTask, walls: Sequence[Obstacle], height: float) -> SE3:
    """The object as low between the walls as they let it."""
    shape, pose = task.object.shape, task.T_world_object
    pairs = [shape_pair(Box(tuple(w.size.tolist())).coal_geometry(), shape) for w in walls]

    def lifted(by: float) -> SE3:
        return SE3(pose.rotation, pose.translation + np.array([0.0, 0.0, by]))

    low, high = 0.0, height + 2 * APART
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        there = lifted(middle)
        apart = (p.distance(w.T_world_obstacle, there) for p, w in zip(pairs, walls, strict=True))
        low, high = (low, middle) if min(apart) > APART else (middle, high)
    return lifted(high)
