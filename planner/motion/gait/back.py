"""``plan_back``: fingers go back to where a motion began, wherever on its way the object is now.

For a turn that does not go on: the fingers move on one at a time, the object held still, and the
motion is made again from its beginning. ``plan_others`` is for a lift that is refused while fingers
move on: those that are left do it in another order.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from planner.motion.gait.check import GaitJudge
from planner.motion.gait.order import NoOrder
from planner.motion.gait.plan import Relocation
from planner.motion.plan import MotionPlan

__all__ = ["cut_motion", "plan_back", "plan_others"]


def cut_motion(motion: MotionPlan, place: float) -> MotionPlan:
    """The part of a motion up to the knot that is nearest to a place, at least to the second.

    Args:
        motion: The whole.
        place: Where on its path, 0 to 1.
    """
    places = np.array([knot.place for knot in motion.knots])
    last = max(1, int(np.abs(places - place).argmin()))
    return replace(
        motion, knots=motion.knots[: last + 1], path=motion.path.cut(float(places[last]))
    )


def plan_back(motion: MotionPlan, place: float) -> tuple[Relocation, ...] | str:
    """Relocations of all fingers from a place of a motion to its beginning; or why there are none.

    Args:
        motion: The motion.
        place: Where on its path it is now, 0 to 1; the nearest knot stands for it.
    """
    task = motion.grasp.task
    if len(task.fingers) - 1 < task.fingers_needed:
        return f"{len(task.fingers)} fingers are too few to lift one of them"
    found = GaitJudge(task).relocations(cut_motion(motion, place))
    return str(found) if isinstance(found, NoOrder) else found


def plan_others(
    stroke: MotionPlan, moved: Collection[str], refused: Collection[str]
) -> tuple[Relocation, ...] | str:
    """Relocations of the fingers that are left after a stroke, others first; or why there are none.

    Args:
        stroke: The stroke.
        moved: Names of the fingers that have moved on already.
        refused: Names of those that cannot be lifted next.
    """
    task = stroke.grasp.task
    numbers = [frozenset(map(task.finger_names.index, names)) for names in (moved, refused)]
    found = GaitJudge(task).relocations(stroke, moved=numbers[0], refused=numbers[1])
    return str(found) if isinstance(found, NoOrder) else found
