"""``manipulation_task``: a task whose grip is just what friction needs to carry the weight."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from planner.errors import TaskError
from planner.hands.hand import Hand
from planner.objects import GraspObject
from planner.task import GraspTask

__all__ = ["manipulation_task", "with_fingers"]

LEAST_GRIP = 1.5
"""Smallest normal force (N) per finger: with less, contacts of three fingers were lost at times."""


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
            (``planner.motion.manipulation.fallbacks``).

    Raises:
        TaskError: A hand on an arm.
    """
    task = GraspTask.create(hand, object, mu=mu, fingers=fingers)
    if task.hand.arm is not None:
        raise TaskError(
            f"{task.hand.name} is carried by an arm; objects are turned in the hand by hands whose "
            "base is free: give the hand without its arm ('opposable hands' lists what there is)"
        )
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
