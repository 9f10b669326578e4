"""``plan_manipulation``: pick an object from a table, turn it in the hand, put it down elsewhere.

A plan is a motion on one grasp with a way into it, a way out of its end, and the pose in which the
object is to stand at last.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pinocchio as pin

from planner.errors import NoGraspFoundError, TaskError
from planner.gait import GaitPlan
from planner.hand import Hand
from planner.motion import MotionAttempt, MotionPlan, ObjectPath, motion_attempts
from planner.motion.path import LARGEST_TURN
from planner.motion.release import find_release
from planner.objects import GraspObject
from planner.spatial import SE3, FloatArray
from planner.synthesis.joint_objectives import driving
from planner.synthesis.pregrasp import Approach
from planner.task import GraspTask

__all__ = [
    "LITTLE_MORE",
    "MAX_ATTEMPTS",
    "ManipulationPlan",
    "manipulation_task",
    "object_at_target",
    "plan_manipulation",
    "torque_reserve",
]

MORE, FIRST, THEN = math.radians(8.0), 10, 8
"""Turn (rad) that is planned beyond what is asked for, since a grasp that is made a little beside
its place meets a joint's end before the plan does; attempts for it; and attempts with one finger
less, for each, where fingers may be spared."""

LITTLE_MORE = math.radians(2.0)
"""Turn (rad) beyond what is asked for where no other plan is found, and of a turn by strokes, where
what is left over is made up for by the last."""

GOOD_RESERVE, CANDIDATES = 0.25, 3
"""A plan that leaves this share of every actuator is taken at once; otherwise the one that leaves
most of this many. What is left moves the fingers and answers to what was not planned for: pushes,
slips, an object that stands beside its place. Of 21 Allegro trials the one that stalled had 0.01.
"""

TUBE = 0.02
"""Default radius (m) of the tube: what is free gives some ten degrees more."""

MAX_ATTEMPTS = 50
"""Attempts before giving up."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ManipulationPlan:
    """Pick, turn, place.

    Attributes:
        motion: The turn in the hand, with the grasp that it begins with; goes a little beyond
            ``angle``.
        angle: Turn that is asked for, rad, with its sign.
        T_world_target: Where the object is to stand at last.
        release: Fingers opened at the end, and the way out, where the motion ends.
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
    release: Approach
    reserve: float
    attempts: int
    cpu_s: float
    gait: GaitPlan | None = None


def plan_manipulation(
    task: GraspTask,
    *,
    axis: Sequence[float] | FloatArray = (0.0, 0.0, 1.0),
    angle: float,
    place: tuple[float, float] | None = None,
    tube: float = TUBE,
    seed: int = 0,
    max_attempts: int = MAX_ATTEMPTS,
) -> ManipulationPlan:
    """Plan it all.

    Args:
        task: What stands where, on a table, and the hand. Where it may spare fingers, plans are
            tried with one less too, and the plan's task says with which.
        axis: Axis of the turn (3,), world.
        angle: Turn in the hand, rad, with its sign.
        place: Where the object is to stand, x and y in m, world; where it was if None.
        tube: Radius within which the object may leave its place while it is turned, m.
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
    made: list[MotionAttempt] = []
    found: list[ManipulationPlan] = []
    for chosen, more, attempts in _rounds(task):
        if len(made) >= max_attempts:
            break
        further = max(abs(angle), min(abs(angle) + more, LARGEST_TURN))
        path = ObjectPath(axis=direction, angle=math.copysign(further, angle), shift=np.zeros(3))
        most = min(max_attempts, len(made) + attempts)
        for attempt in motion_attempts(chosen, path, tube=tube, seed=seed):
            if len(made) >= most or _enough(found):
                break
            made.append(attempt)
            if attempt.plan is None:
                continue
            release = find_release(attempt.plan)
            if isinstance(release, str):
                reason = f"cannot let go at the end: {release}"
                made[-1] = replace(attempt, plan=None, reason=reason)
                continue
            found.append(
                ManipulationPlan(
                    motion=attempt.plan,
                    angle=angle,
                    T_world_target=object_at_target(task, path.axis, angle, place),
                    release=release,
                    reserve=torque_reserve(attempt.plan),
                    attempts=0,
                    cpu_s=0.0,
                )
            )
        if found:
            best = max(found, key=lambda plan: plan.reserve)
            return replace(best, attempts=len(made), cpu_s=sum(a.cpu_s for a in made))
    reasons = Counter(a.reason for a in made).most_common(3)
    why = "; ".join(f"{n} x {reason}" for reason, n in reasons)
    raise NoGraspFoundError(
        f"no way to turn {task.object.name} by {np.rad2deg(angle):.1f} degrees with "
        f"{task.hand.name} ({', '.join(task.finger_names)}) in {len(made)} attempts: {why}. Try "
        "a smaller turn, a wider tube, other fingers or more attempts",
        tuple(made),
    )


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
        fingers: Finger names; if None the hand's default set, of which one may be spared.
    """
    task = GraspTask.create(hand, object, mu=mu, fingers=fingers)
    weight = task.object.mass * float(np.linalg.norm(task.gravity))
    grip = max(LEAST_GRIP, weight / (task.mu * len(task.finger_names)))
    return replace(task, grip_force=grip)


LEAST_GRIP = 1.5
"""Smallest normal force (N) per finger: with less, contacts of three fingers were lost at times."""


def _rounds(task: GraspTask) -> Iterator[tuple[GraspTask, float, int]]:
    """What is tried in turn: a task, how much more than is asked for (rad), and how often."""
    yield task, MORE, FIRST
    n = len(task.finger_names)
    if task.may_spare_fingers and n > task.fingers_needed:
        # the thumb, which comes first, is spared last
        for spared in reversed(task.finger_names):
            others = tuple(name for name in task.finger_names if name != spared)
            grip = task.grip_force * n / (n - 1)
            yield replace(task, finger_names=others, grip_force=grip), MORE, THEN
    while True:
        yield task, LITTLE_MORE, FIRST


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
    return len(found) >= CANDIDATES or any(p.reserve >= GOOD_RESERVE for p in found)


def object_at_target(
    task: GraspTask, axis: FloatArray, angle: float, place: tuple[float, float] | None
) -> SE3:
    """The object turned, at a place, with its lowest point on the table."""
    turned = pin.exp3(angle * axis) @ task.T_world_object.rotation
    x, y = task.T_world_object.translation[:2] if place is None else place
    height = task.object.shape.support(-turned[2])
    return SE3(turned, np.array([x, y, (task.table_height or 0.0) + height]))
