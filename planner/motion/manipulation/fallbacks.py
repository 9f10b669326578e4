"""The fallback schedule of a turn in the hand: which fingers and pads are tried, and how far."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

from planner.errors import TaskError
from planner.motion.manipulation.task import with_fingers
from planner.motion.starts import tripods, with_rolling_pads
from planner.synthesis.seeds.mesh import turning_seeder_for
from planner.task import GraspTask

__all__ = ["LEAST_OVERSHOOT", "Fallback", "fallback_schedule"]

OVERSHOOT, TIPS_OVERSHOOT, LEAST_OVERSHOOT = (math.radians(degrees) for degrees in (8.0, 5.0, 2.0))
"""Planned overshoot (rad) of the turn: a grasp made beside its place meets a joint limit before the
plan does, and the reference of an object that lags continues into the overshoot. Less of it for
objects that turn the fingertips along (``Shape.turns_tips``), of which hands turn the wide ones
little further. Least of it where no other plan is found, and for turns by several strokes, whose
last stroke makes up for what is left over."""

FIRST, FIRST_TIPS, LATER = 3, 6, 8
"""Attempts of the first entry, the same for objects that turn the tips along, of which a third of
the starts hold, and those of each later entry. Of 28 cylinders in two hands 16 found a plan with
all fingers within three attempts, 11 with one finger less (those of 60 mm and more in the
Shadow-type hand, for which three more with four fingers changed nothing), one with all later."""


@dataclass(frozen=True, kw_only=True)
class Fallback:
    """One entry of the schedule.

    Attributes:
        task: The task, with the fingers and the pads of this entry.
        overshoot: Turn planned beyond what is asked for, rad.
        attempts: Attempts before the next entry; None until a plan is found.
    """

    task: GraspTask
    overshoot: float
    attempts: int | None


def fallback_schedule(task: GraspTask) -> Iterator[Fallback]:
    """What is tried in turn.

    An entry ends the search if it gives a good plan, or enough plans with those before it:

        object       fingers and pads                     overshoot       attempts
        cylinder     all fingers                          8 degrees       3
                     one less, for each; thumb last       8               8
                     all, pads as wide as tips are round  8               3
        block, mesh  thumb and the first two neighbours   5               6
                     each other pair of neighbours        5               8
        ball         the same, and after its first entry  2               6
        any          the first fingers                    2               until one is found

    Fingers that the caller names all take part.
    """
    tips = task.object.shape.turns_tips
    sets = [task]
    if task.may_spare_fingers and len(task.finger_names) > task.fingers_needed:
        if tips:
            # a fourth finger has to go all the way as well: on blocks it stays on its face and
            # turns with it, on balls no start of 6 holds with four fingers of the Shadow-type hand
            sets = [with_fingers(task, names) for names in tripods(task)]
        else:
            # the thumb comes first and is left out last
            for left_out in reversed(task.finger_names):
                names = [name for name in task.finger_names if name != left_out]
                sets.append(with_fingers(task, names))
    overshoot, first = (TIPS_OVERSHOOT, FIRST_TIPS) if tips else (OVERSHOOT, FIRST)
    yield Fallback(task=sets[0], overshoot=overshoot, attempts=first)
    if task.object.shape.ball_like:
        yield Fallback(task=sets[0], overshoot=LEAST_OVERSHOOT, attempts=first)
    for one in filter(_closes, sets[1:]):
        yield Fallback(task=one, overshoot=overshoot, attempts=LATER)
    # contacts are nearer to the rims of pads on cylinders that are wide for a hand
    if not with_rolling_pads(sets[0]).hand.rolls:
        rolling = replace(sets[0], hand=task.hand.rolling)
        yield Fallback(task=rolling, overshoot=overshoot, attempts=first)
    yield Fallback(task=sets[0], overshoot=LEAST_OVERSHOOT, attempts=None)


def _closes(task: GraspTask) -> bool:
    """Whether the fingers open wide enough for the object: without a thumb they may not."""
    try:
        turning_seeder_for(task)
    except TaskError:
        return False
    return True
