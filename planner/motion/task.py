"""Tasks of manipulations: the grip that friction needs, and an object on a stand.

A hand that grasps from above needs room below the fingertips, 26 mm under the centre of an object
with the Shadow-type hand and 38 mm with the Allegro-type hand. A ball or a small block on a table
leaves less, so ``on_stand`` puts it on four walls in a square. A round object lies in the opening
and cannot roll away; a flat one stands on the walls. Whether it stays there is for a simulation to
tell (``sim.manipulation.settled``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from planner.collision.pair_table import lift_to_rest
from planner.errors import TaskError
from planner.hands.hand import Hand
from planner.objects import GraspObject
from planner.spatial import SE3, FloatArray
from planner.task import GraspTask, Obstacle

LEAST_GRIP = 1.5
"""Smallest normal force (N) per finger: with less, contacts of three fingers were lost at times."""

SEEDS_APART = 1000
"""Distance between the seeds of searches that one search makes, so that a caller's next seeds give
others."""


def manipulation_task(
    hand: Hand | str | Path,
    object: GraspObject,
    *,
    mu: float,
    fingers: Sequence[str] | None = None,
) -> GraspTask:
    """A task whose grip force lets friction carry the weight, shared evenly by the fingers.

    A grasp that is only held has twice that by default. A hand that turns an object opposes all
    other fingers by the thumb along the whole path, and its joints have no torque for twice that.

    Args:
        hand: A hand, its name, or the path of its description.
        object: The object, with the largest mass that it may have.
        mu: Sliding friction (-), the least that there may be.
        fingers: Finger names; if None the hand's default set, of which planning may leave some out
            (``planner.motion.single_stroke``).
    """
    task = GraspTask.create(hand, object, mu=mu, fingers=fingers)
    return replace(task, grip_force=max(LEAST_GRIP, _carrying_force(task, len(task.finger_names))))


def with_fingers(task: GraspTask, names: Sequence[str]) -> GraspTask:
    """The task for some of its fingers, which carry the weight alone."""
    grip = max(task.grip_force, _carrying_force(task, len(names)))
    return replace(task, finger_names=tuple(names), may_spare_fingers=False, grip_force=grip)


def _carrying_force(task: GraspTask, n: int) -> float:
    """Least normal force (N) of each of n fingers with which all carry the weight by friction.

    On a block one finger opposes all others and presses as much as they do together.
    """
    weight = task.object.mass * float(np.linalg.norm(task.gravity))
    block = task.object.shape.flat_sides is not None
    return weight / (task.mu * (2 * (n - 1) if block else n))


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
        raise TaskError("there is no table for a stand; give table_height (--table)")
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
