"""What is tried in turn for a turn in the hand: which fingers, with which pads, and how far.

``manipulation_task`` gives the task its grip; ``rounds`` goes through the fingers that may be
spared.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from planner.motion.ground import tripods, with_rolling_pads

from planner.errors import TaskError
from planner.hands.hand import Hand
from planner.objects import GraspObject
from planner.synthesis.seeds.mesh import turning_seeder_for
from planner.task import GraspTask

__all__ = ["LITTLE_MORE", "is_ball", "manipulation_task", "rounds"]

MORE, LESS_MORE, LITTLE_MORE = (math.radians(degrees) for degrees in (8.0, 5.0, 2.0))
"""Turn (rad) that is planned beyond what is asked for, since a grasp that is made a little beside
its place meets a joint's end before the plan does, and an object that lags is led on there. Less of
it for objects that take the tips along (``Shape.turns_tips``), of which hands turn the
wide ones little further; little where no other plan is found, and of a turn by strokes, where the
last makes up for what is left over."""

FIRST, FIRST_TIPS, THEN = 3, 6, 8
"""Attempts of the first round, the same for objects that take the tips along, of which a third of
the starts hold, and those of each round after it. Of 28 cylinders in two hands 16 found a plan
with all fingers among three attempts, 11 with one finger less (those of 60 mm and more in the
Shadow-type hand, for which three more with four fingers changed nothing), one with all later."""


def manipulation_task(
    hand: Hand | str | Path,
    object: GraspObject,
    *,
    mu: float,
    fingers: Sequence[str] | None = None,
) -> GraspTask:
    """A task with a grip that friction carries the weight with, shared evenly.

    A grasp that is only held has twice that by default; the thumb of a hand that turns has to
    oppose all other fingers along the whole path, and its joints have no torque for that.

    Args:
        hand: A hand, its name, or the path of its description.
        object: The object, with the largest mass that it may have.
        mu: Sliding friction (-), the least that there may be.
        fingers: Finger names; if None the hand's default set, of which ``rounds`` may spare some.

    Raises:
        TaskError: A hand on an arm.
    """
    task = GraspTask.create(hand, object, mu=mu, fingers=fingers)
    if task.hand.arm is not None:
        raise TaskError(
            f"{task.hand.name} is carried by an arm; objects are turned in the hand by hands whose "
            "base is free: give the hand without its arm ('opposable hands' lists what there is)"
        )
    return replace(task, grip_force=max(LEAST_GRIP, _carrying(task, len(task.finger_names))))


def _carrying(task: GraspTask, n: int) -> float:
    """Least normal force (N) of each of n fingers with which all carry the weight by friction.

    On a block one finger opposes all others, so it presses as much as they do together.
    """
    weight = task.object.mass * float(np.linalg.norm(task.gravity))
    block = task.object.shape.flat_sides is not None
    return weight / (task.mu * (2 * (n - 1) if block else n))


def _with_fingers(task: GraspTask, names: Sequence[str]) -> GraspTask:
    """The task for some of its fingers, which carry the weight alone."""
    grip = max(task.grip_force, _carrying(task, len(names)))
    return replace(task, finger_names=tuple(names), may_spare_fingers=False, grip_force=grip)


def _takes_tips(task: GraspTask) -> bool:
    """Whether the fingertips turn with the object, which asks more of the fingers."""
    return task.object.shape.turns_tips


def is_ball(task: GraspTask) -> bool:
    """Whether the object is round in every direction."""
    return task.object.shape.ball_like


LEAST_GRIP = 1.5
"""Smallest normal force (N) per finger: with less, contacts of three fingers were lost at times."""


def rounds(task: GraspTask) -> Iterator[tuple[GraspTask, float, int | None]]:
    """What is tried in turn: a task, how much more than is asked for (rad), and how often.

    Each row ends the search if it brings a good plan, or with those before it enough of them:

        cylinder     all fingers                          + 8 degrees     3 attempts
                     one less, for each; thumb last       + 8             8
                     all, pads as wide as tips are round  + 8             3
        block, mesh  thumb and the first two neighbours   + 5             6
                     each other pair of neighbours        + 5             8
        ball         the same, and after its first row    + 2             6
        any          the first fingers                    + 2             until one is found

    Fingers that the caller names are not spared.
    """
    chosen = [task]
    if task.may_spare_fingers and len(task.finger_names) > task.fingers_needed:
        if _takes_tips(task):
            # a fourth finger has to go all the way as well: on blocks it stays on its face and
            # turns with it, on balls no start of 6 holds with four fingers of the Shadow-type hand
            chosen = [_with_fingers(task, names) for names in tripods(task)]
        else:
            # the thumb, which comes first, is spared last
            for spared in reversed(task.finger_names):
                names = [name for name in task.finger_names if name != spared]
                chosen.append(_with_fingers(task, names))
    more, first = (LESS_MORE, FIRST_TIPS) if _takes_tips(task) else (MORE, FIRST)
    yield chosen[0], more, first
    if is_ball(task):
        yield chosen[0], LITTLE_MORE, first
    for one in filter(_closes, chosen[1:]):
        yield one, more, THEN
    # contacts are nearer to the rims of pads on cylinders that are wide for a hand
    if not with_rolling_pads(chosen[0]).hand.rolls:
        yield replace(chosen[0], hand=task.hand.rolling), more, first
    yield chosen[0], LITTLE_MORE, None


def _closes(task: GraspTask) -> bool:
    """Whether the fingers open wide enough for the object: without a thumb they may not."""
    try:
        turning_seeder_for(task)
    except TaskError:
        return False
    return True
