"""``plan_single_stroke``: pick an object up, turn or move it on one grasp, put it down.

Turns about the vertical are what hands do best: tips roll around the object. Where it is tilted or
moved, tips may have to pivot on their contacts instead, which is bounded here.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from planner.attempt import nothing_found
from planner.errors import TaskError
from planner.failure import Failure
from planner.motion.manipulation.ending import Rests, planned_ending
from planner.motion.manipulation.fallbacks import fallback_schedule
from planner.motion.manipulation.plan import ManipulationPlan, torque_reserve
from planner.motion.path import LARGEST_TURN, ObjectPath, tilts
from planner.motion.plan import MotionPlan
from planner.motion.search import MotionAttempt, motion_attempts
from planner.spatial import FloatArray
from planner.task import GraspTask

__all__ = ["MAX_ATTEMPTS", "MOST_PIVOT", "good_enough", "merit", "plan_single_stroke"]

CANDIDATES = 3
"""Plans of which the best is taken, unless one is good enough to be taken at once; fewer where the
schedule gives no more."""

GOOD_RESERVE, GOOD_MARGIN = 0.1, 0.15
"""Share of its limit that every actuator keeps, and margin of closure (-), with which a plan is
good enough. The rest moves the fingers and answers to what was not planned for: pushes, slips,
an object that stands beside its place. Of 21 turns by the Allegro-type hand the one that stalled
kept 0.01; of 22 turns of cylinders by the Shadow-type hand the two that failed had margins of 0.06
and 0.09, those looked at beside them 0.17 and more."""

GOOD_ON_BALLS = 0.4
"""Margin of closure (-) that is asked of a plan for a ball, and nothing else. Those plans are of
two sorts. Either one finger opposes another with 12 to 20 N, which leaves a margin of 0.25 to 0.34
and much torsional friction; or all press alike, with less than 9 N, and leave 0.44 to 0.73. In the
Shadow-type hand 4 of 6 turns of the first sort fell short of 90 degrees, and none of a dozen of the
second."""

TUBE, TILT_TUBE, SHIFT_TUBE = 0.03, 0.01, 0.0
"""Default path tolerance (m) of turns about the vertical, of tilts, and of translations: what is
tilted or moved is to get where it was asked to. The freedom of a turn gives some ten degrees more.
A finger of the Shadow-type hand has to go a third of the way around with a face, and no further
than 40 degrees to the side; with 20 mm it turns blocks by 89 degrees, with 30 by 97. Of 6 starts
for 98 degrees on cylinders of 64 and 70 mm 5 and 5 hold with three of its fingers and 30 mm, 1 and
0 with 20."""

MAX_ATTEMPTS = 50
"""Attempts before giving up."""

MOST_PIVOT = math.radians(12.0)
"""Most (rad) that a tip may pivot while the object is tilted or moved. Of 15 tilts by 30 degrees
with more, boxes, cylinders and balls in both hands, 5 were made, of 24 with less all."""


def plan_single_stroke(
    task: GraspTask,
    *,
    axis: Sequence[float] | FloatArray = (0.0, 0.0, 1.0),
    angle: float,
    shift: Sequence[float] | FloatArray = (0.0, 0.0, 0.0),
    place: tuple[float, float] | None = None,
    tube: float | None = None,
    seed: int = 0,
    max_attempts: int = MAX_ATTEMPTS,
    rests: Rests | None = None,
) -> ManipulationPlan:
    """Plan a manipulation on one grasp.

    Args:
        task: What stands where, on a table, and the hand. Where it may spare fingers, plans are
            tried with one less too (``fallback_schedule``), and the plan's task has the chosen.
        axis: Axis of the turn (3,), world.
        angle: Turn in the hand, rad, with its sign.
        shift: Translation in the hand (3,), m, world, evenly along the turn.
        place: Where the object is to stand, x and y in m, world; where it was if None.
        tube: Path tolerance: how far the object may leave its path, m; if None ``TUBE``, or
            ``TILT_TUBE`` or ``SHIFT_TUBE`` where it is tilted or moved.
        seed: Same seed, same plan.
        max_attempts: Budget in attempts.
        rests: Tells whether an object stays where a task has it, as ``sim.manipulation.rests``;
            None takes geometry alone.

    Raises:
        NoGraspFoundError: The budget ended.
        TaskError: No table, or what ``plan_motion`` refuses.
    """
    if task.table_height is None:
        raise TaskError("there is no table to pick from and to place on; give table_height")
    if max_attempts < 1:
        raise TaskError(f"max_attempts is {max_attempts}; give at least 1")
    direction = np.asarray(axis, dtype=np.float64)
    moved = np.asarray(shift, dtype=np.float64)
    if tube is None:
        tube = SHIFT_TUBE if moved.any() else TILT_TUBE if tilts(direction) else TUBE
    made: list[MotionAttempt] = []
    tried: list[tuple[str, ...]] = []
    found: list[ManipulationPlan] = []
    for fallback in fallback_schedule(task):
        attempts = fallback.attempts
        if len(made) >= max_attempts or good_enough(found) or (attempts is None and found):
            break
        tried.append(fallback.task.finger_names)
        path = _with_overshoot(direction, angle, moved, fallback.overshoot)
        most = max_attempts if attempts is None else min(max_attempts, len(made) + attempts)
        for attempt in motion_attempts(fallback.task, path, path_tolerance=tube, seed=seed):
            if len(made) >= most or good_enough(found):
                break
            made.append(attempt)
            if attempt.plan is None:
                continue
            ending = _pivoting(attempt.plan) or planned_ending(
                attempt.plan, angle, place, rests=rests
            )
            if isinstance(ending, Failure):
                made[-1] = replace(attempt, plan=None, failure=ending)
                continue
            found.append(
                ManipulationPlan(
                    motion=attempt.plan,
                    angle=angle,
                    shift=moved,
                    ending=ending,
                    reserve=torque_reserve(attempt.plan),
                    attempts=0,
                    cpu_s=0.0,
                )
            )
    if found:
        best = max(found, key=merit)
        return replace(best, attempts=len(made), cpu_s=sum(a.cpu_s for a in made))
    asked = ObjectPath(axis=direction, angle=angle, shift=moved)
    sets = " or ".join(", ".join(names) for names in dict.fromkeys(tried))
    raise nothing_found(
        f"way to turn or move {task.object.name} by {asked} with {task.hand.name} ({sets})",
        made,
        "Try a smaller turn, a wider tube, other fingers or more attempts",
    )


def good_enough(found: Sequence[ManipulationPlan]) -> bool:
    """Whether it is time to take the best of what was found."""
    return len(found) >= CANDIDATES or any(merit(p) >= 1.0 for p in found)


def merit(plan: ManipulationPlan) -> float:
    """How good a plan is (-), from 1 on good enough to be taken at once."""
    if plan.task.object.shape.ball_like:
        return plan.motion.margin / GOOD_ON_BALLS
    return min(plan.reserve / GOOD_RESERVE, plan.motion.margin / GOOD_MARGIN)


def _with_overshoot(
    axis: FloatArray, angle: float, shift: FloatArray, overshoot: float
) -> ObjectPath:
    """The path asked for with an overshoot (rad) of the turn, and the same share of translation."""
    if angle == 0.0:
        return ObjectPath(axis=axis, angle=0.0, shift=shift)
    turn = max(abs(angle), min(abs(angle) + overshoot, LARGEST_TURN))
    whole = math.copysign(turn, angle)
    return ObjectPath(axis=axis, angle=whole, shift=whole / angle * shift)


def _pivoting(motion: MotionPlan) -> Failure | None:
    """Which tip pivots too far on its contact when the object is tilted or moved, None for none.

    Torsional friction, which the controller does not know of, would hold the object up.
    """
    if not (motion.path.shift.any() or tilts(motion.path.axis)):
        return None
    pivoted = motion.pivoted
    worst = int(np.argmax(pivoted))
    if pivoted[worst] <= MOST_PIVOT:
        return None
    degrees = float(np.rad2deg(pivoted[worst]))
    name = motion.grasp.task.finger_names[worst]
    return Failure(
        kind="pivots",
        text=f"{name} pivots on its contact by {degrees:.0f} degrees",
        numbers={"pivot_deg": degrees},
    )
