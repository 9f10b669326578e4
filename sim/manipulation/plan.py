"""``plan_manipulation``: pick an object from a table, turn it in the hand, put it down elsewhere.

A plan is a motion on one grasp with a way into it, a way out of its end, and the pose in which the
object is to stand at last.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from planner.errors import NoGraspFoundError, TaskError
from planner.gait import GaitPlan
from planner.hand import Hand
from planner.motion import MotionAttempt, MotionPlan, ObjectPath, motion_attempts
from planner.motion.ground import with_rolling_pads
from planner.motion.problem import BALLS
from planner.objects import GraspObject
from planner.shapes import Box, Ellipsoid, Mesh, Sphere
from planner.spatial import SE3, FloatArray
from planner.synthesis.joint_objectives import driving
from planner.synthesis.mesh_seeds import seeder_for
from planner.synthesis.pregrasp import Approach
from planner.task import GraspTask, Obstacle
from sim.manipulation.ending import planned_ending, standing_under
from sim.manipulation.paths import further, narrow_tube, pivots

__all__ = [
    "LITTLE_MORE",
    "MAX_ATTEMPTS",
    "ManipulationPlan",
    "manipulation_task",
    "plan_manipulation",
    "torque_reserve",
]

MORE, FIRST, THEN = math.radians(8.0), 10, 8
"""Turn (rad) that is planned beyond what is asked for, since a grasp that is made a little beside
its place meets a joint's end before the plan does; attempts for it; and attempts with one finger
less, for each, where fingers may be spared."""

LESS_MORE = math.radians(5.0)
"""The same for objects ``WITH_TIPS``, of which hands turn the wide ones little further than that.
"""

WITH_TIPS = (Box, Mesh, Sphere, Ellipsoid)
"""Shapes that take the tips along: on a face a tip has to turn with it, and on a ball a
tip that does not do so pivots."""

FOR_THREE = (Box, Sphere, Ellipsoid, Mesh)
"""Shapes that three fingers turn."""

LITTLE_MORE = math.radians(2.0)
"""Turn (rad) beyond what is asked for where no other plan is found, and of a turn by strokes, where
what is left over is made up for by the last."""

GOOD_RESERVE, CANDIDATES = 0.25, 3
"""A plan that leaves this share of every actuator is taken at once; otherwise the one that leaves
most of this many. What is left moves the fingers and answers to what was not planned for: pushes,
slips, an object that stands beside its place. Of 21 Allegro trials the one that stalled had 0.01.
"""

GOOD_MARGIN = 0.4
"""Margin of closure (-) with which a plan for a ball is taken at once; otherwise the one with most.
Plans for balls are of two sorts. Either one finger opposes another with 12 to 20 N, which leaves a
margin of 0.25 to 0.34 and much torsional friction; or all press alike, with less than 9 N, and
leave 0.44 to 0.73. In the Shadow-type hand 4 of 6 turns of the first sort fell short of 90 degrees,
and none of a dozen of the second."""

TUBE, WIDE_TUBE = 0.02, 0.03
"""Default radii (m) of the tube: what is free gives some ten degrees more. For objects
``WITH_TIPS``: a finger of the Shadow-type hand has to go a third of the way around with a face, and
no further than 40 degrees to the side; with 20 mm it turns blocks by 89 degrees, with 30 by 97."""

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
            ``TUBE``, or ``WIDE_TUBE`` for blocks, balls and meshes. Where it is tilted or moved,
            ``narrow_tube``.
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
        tube = narrow_tube(direction, moved)
    if tube is None:
        tube = WIDE_TUBE if _takes_tips(task) else TUBE
    made: list[MotionAttempt] = []
    found: list[ManipulationPlan] = []
    for chosen, more, attempts in _rounds(task):
        if len(made) >= max_attempts:
            break
        path = further(direction, angle, moved, more)
        most = max_attempts if attempts is None else min(max_attempts, len(made) + attempts)
        for attempt in motion_attempts(chosen, path, tube=tube, seed=seed):
            if len(made) >= most or _enough(found):
                break
            made.append(attempt)
            if attempt.plan is None:
                continue
            pivoted = pivots(attempt.plan)
            if pivoted:
                made[-1] = replace(attempt, plan=None, reason=pivoted)
                continue
            ending = planned_ending(attempt.plan, angle, place)
            if isinstance(ending, str):
                made[-1] = replace(attempt, plan=None, reason=ending)
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
        if _settled(found):
            break
    if found:
        best = max(found, key=_merit)
        return replace(best, attempts=len(made), cpu_s=sum(a.cpu_s for a in made))
    reasons = Counter(a.reason for a in made).most_common(3)
    why = "; ".join(f"{n} x {reason}" for reason, n in reasons)
    asked = ObjectPath(axis=direction, angle=angle, shift=moved)
    raise NoGraspFoundError(
        f"no way to turn or move {task.object.name} by {asked} with "
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
    block = task.object.shape.kind == "box"
    return weight / (task.mu * (2 * (n - 1) if block else n))


def _with_fingers(task: GraspTask, names: Sequence[str]) -> GraspTask:
    """The task for some of its fingers, which carry the weight alone."""
    grip = max(task.grip_force, _carrying(task, len(names)))
    return replace(task, finger_names=tuple(names), may_spare_fingers=False, grip_force=grip)


def _takes_tips(task: GraspTask) -> bool:
    """Whether the fingertips turn with the object, which asks more of the fingers."""
    return isinstance(task.object.shape, WITH_TIPS)


def _is_ball(task: GraspTask) -> bool:
    """Whether the object is round in every direction."""
    return task.object.shape.kind in BALLS


LEAST_GRIP = 1.5
"""Smallest normal force (N) per finger: with less, contacts of three fingers were lost at times."""


def _rounds(task: GraspTask) -> Iterator[tuple[GraspTask, float, int | None]]:
    """What is tried in turn: a task, how much more than is asked for (rad), and how often."""
    chosen = [task]
    if task.may_spare_fingers and len(task.finger_names) > task.fingers_needed:
        if isinstance(task.object.shape, FOR_THREE):
            chosen = [_with_fingers(task, names) for names in _tripods(task)]
        else:
            # the thumb, which comes first, is spared last
            for spared in reversed(task.finger_names):
                names = [name for name in task.finger_names if name != spared]
                chosen.append(_with_fingers(task, names))
    more = LESS_MORE if _takes_tips(task) else MORE
    yield chosen[0], more, FIRST
    if _is_ball(task) or isinstance(task.object.shape, Mesh):
        yield chosen[0], LITTLE_MORE, FIRST
    for one in filter(_closes, chosen[1:]):
        yield one, more, THEN
    # a cylinder of 7 cm is too wide for the Shadow-type hand's pads, and not for its round tips
    if not with_rolling_pads(chosen[0]).hand.rolls:
        yield replace(chosen[0], hand=task.hand.rolling), more, FIRST
    yield chosen[0], LITTLE_MORE, None


def _closes(task: GraspTask) -> bool:
    """Whether the fingers open wide enough for the object: without a thumb they may not."""
    try:
        seeder_for(task)
    except TaskError:
        return False
    return True


def _tripods(task: GraspTask) -> list[tuple[str, ...]]:
    """The finger that opposes the others with each pair of neighbours among those.

    A fourth finger has to go all the way as well: on blocks it stays on its face and turns with it,
    on balls no start of 6 holds with four fingers of the Shadow-type hand, and 4 with three.
    """
    opposer = task.finger_names[seeder_for(task).pinch.opposer]
    others = [name for name in task.finger_names if name != opposer]
    return [(opposer, *pair) for pair in pairwise(others)]


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


def _settled(found: list[ManipulationPlan]) -> bool:
    """Whether what was found makes another round needless: for a ball a good plan is worth one."""
    return any(not _is_ball(p.motion.grasp.task) for p in found) or _enough(found)


def _merit(plan: ManipulationPlan) -> float:
    """How good a plan is (-), from 1 on good enough to be taken at once."""
    if _is_ball(plan.motion.grasp.task):
        return plan.motion.margin / GOOD_MARGIN
    return plan.reserve / GOOD_RESERVE
