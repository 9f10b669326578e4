"""``plan_manipulation``: pick an object from a table, turn it in the hand, put it down elsewhere.

A plan is a motion on one grasp with a way into it, a way out of its end, and the pose in which the
object is to stand at last.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from planner.attempts import nothing_found

from planner.approach.pregrasp import Approach
from planner.errors import TaskError
from planner.failure import Failure
from planner.motion import MotionAttempt, MotionPlan, ObjectPath, motion_attempts
from planner.motion.gait import GaitPlan
from planner.spatial import SE3, FloatArray
from planner.synthesis.objectives.joint import driving
from planner.task import GraspTask, Obstacle
from sim.manipulation.ending import planned_ending, standing_under
from sim.manipulation.paths import further, narrow_tube, pivots
from sim.manipulation.rounds import is_ball, rounds

__all__ = [
    "MAX_ATTEMPTS",
    "ManipulationPlan",
    "plan_manipulation",
    "torque_reserve",
]

CANDIDATES = 3
"""Plans of which the best is taken, unless one is good enough to be taken at once. Where all that
is tried by turns gives fewer, the best of those is."""

GOOD_RESERVE, GOOD_MARGIN = 0.1, 0.15
"""Share of its limit that every actuator keeps, and margin of closure (-), with which a plan is
good enough. What is kept moves the fingers and answers to what was not planned for: pushes, slips,
an object that stands beside its place. Of 21 turns by the Allegro-type hand the one that stalled
kept 0.01; of 22 turns of cylinders by the Shadow-type hand the two that failed had margins of 0.06
and 0.09, those looked at beside them 0.17 and more."""

GOOD_ON_BALLS = 0.4
"""Margin of closure (-) that is asked of a plan for a ball, and nothing else. Those plans are of
two sorts. Either one finger opposes another with 12 to 20 N, which leaves a margin of 0.25 to 0.34
and much torsional friction; or all press alike, with less than 9 N, and leave 0.44 to 0.73. In the
Shadow-type hand 4 of 6 turns of the first sort fell short of 90 degrees, and none of a dozen of the
second."""

TUBE = 0.03
"""Default radius (m) of the tube: what is free gives some ten degrees more. A finger of the
Shadow-type hand has to go a third of the way around with a face, and no further than 40 degrees to
the side; with 20 mm it turns blocks by 89 degrees, with 30 by 97. Of 6 starts for 98 degrees on
cylinders of 64 and 70 mm 5 and 5 hold with three of its fingers and 30 mm, 1 and 0 with 20."""

MAX_ATTEMPTS = 50
"""Attempts before giving up."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ManipulationPlan:
    """Pick, turn, place.

    Attributes:
        motion: The turn in the hand, with the grasp that it begins with; goes a little beyond
            ``angle``.
        angle: Turn that is asked for, rad, with its sign.
        shift: Translation in the hand that is asked for with it (3,), m, world.
        T_world_target: Where the object is to stand at last.
        under_target: What is to carry it there, if anything carries it above the table at first.
        release: Fingers opened at the end, and the way out, where the motion ends.
        back: Why the motion is made backwards before the object is put down, "" if it is not.
        reserve: Share of its limit that the most loaded actuator has left at the worst knot, with
            the forces that bear the weight.
        attempts: Attempts made.
        cpu_s: CPU time of planning without building, s.
        gait: Strokes and the regrasps between them, where one stroke is not enough; ``motion`` is
            the first of them.
    """

    motion: MotionPlan
    angle: float
    T_world_target: SE3
    under_target: tuple[Obstacle, ...]
    release: Approach
    reserve: float
    attempts: int
    cpu_s: float
    shift: FloatArray = field(default_factory=lambda: np.zeros(3))
    back: str = ""
    gait: GaitPlan | None = None


def plan_manipulation(
    task: GraspTask,
    *,
    axis: Sequence[float] | FloatArray = (0.0, 0.0, 1.0),
    angle: float,
    shift: Sequence[float] | FloatArray = (0.0, 0.0, 0.0),
    place: tuple[float, float] | None = None,
    tube: float | None = None,
    seed: int = 0,
    max_attempts: int = MAX_ATTEMPTS,
) -> ManipulationPlan:
    """Plan it all.

    Args:
        task: What stands where, on a table, and the hand. Where it may spare fingers, plans are
            tried with one less too, and the plan's task says with which.
        axis: Axis of the turn (3,), world.
        angle: Turn in the hand, rad, with its sign.
        shift: Translation in the hand (3,), m, world, evenly along the turn.
        place: Where the object is to stand, x and y in m, world; where it was if None.
        tube: Radius within which the object may leave its place while it is turned, m; if None
            ``TUBE``, or ``narrow_tube`` where it is tilted or moved.
        seed: Same seed, same plan.
        max_attempts: Budget in attempts.

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
        narrow = narrow_tube(direction, moved)
        tube = TUBE if narrow is None else narrow
    made: list[MotionAttempt] = []
    tried: list[tuple[str, ...]] = []
    found: list[ManipulationPlan] = []
    for chosen, more, attempts in rounds(task):
        if len(made) >= max_attempts or _enough(found) or (attempts is None and found):
            break
        tried.append(chosen.finger_names)
        path = further(direction, angle, moved, more)
        most = max_attempts if attempts is None else min(max_attempts, len(made) + attempts)
        for attempt in motion_attempts(chosen, path, path_tolerance=tube, seed=seed):
            if len(made) >= most or _enough(found):
                break
            made.append(attempt)
            if attempt.plan is None:
                continue
            pivoted = pivots(attempt.plan)
            if pivoted:
                failure = Failure(kind="pivots", text=pivoted)
                made[-1] = replace(attempt, plan=None, failure=failure)
                continue
            ending = planned_ending(attempt.plan, angle, place)
            if isinstance(ending, Failure):
                made[-1] = replace(attempt, plan=None, failure=ending)
                continue
            found.append(
                ManipulationPlan(
                    motion=attempt.plan,
                    angle=angle,
                    shift=moved,
                    T_world_target=ending.T_world_target,
                    under_target=standing_under(task, ending.T_world_target),
                    release=ending.release,
                    back=ending.back,
                    reserve=torque_reserve(attempt.plan),
                    attempts=0,
                    cpu_s=0.0,
                )
            )
    if found:
        best = max(found, key=_merit)
        return replace(best, attempts=len(made), cpu_s=sum(a.cpu_s for a in made))
    asked = ObjectPath(axis=direction, angle=angle, shift=moved)
    sets = " or ".join(", ".join(names) for names in dict.fromkeys(tried))
    raise nothing_found(
        f"way to turn or move {task.object.name} by {asked} with {task.hand.name} ({sets})",
        made,
        "Try a smaller turn, a wider tube, other fingers or more attempts",
    )


def torque_reserve(motion: MotionPlan) -> float:
    """Share of its limit that the most loaded actuator of the fingers has left at any knot."""
    task = motion.grasp.task
    actuation, used = task.hand.actuation, driving(task.hand, task.fingers)
    left = 1.0
    for knot in motion.knots:
        low, high = actuation.force_limits(knot.q)[used].T
        force = knot.forces.actuator_forces[used]
        limit = np.where(force > 0, high, -low)
        left = min(left, float((1.0 - np.abs(force) / np.maximum(limit, NO_LIMIT)).min()))
    return left


NO_LIMIT = 1e-9
"""Least limit (N m) that a force is divided by."""


def _enough(found: list[ManipulationPlan]) -> bool:
    """Whether it is time to take the best of what was found."""
    return len(found) >= CANDIDATES or any(_merit(p) >= 1.0 for p in found)


def _merit(plan: ManipulationPlan) -> float:
    """How good a plan is (-), from 1 on good enough to be taken at once."""
    if is_ball(plan.motion.grasp.task):
        return plan.motion.margin / GOOD_ON_BALLS
    return min(plan.reserve / GOOD_RESERVE, plan.motion.margin / GOOD_MARGIN)
