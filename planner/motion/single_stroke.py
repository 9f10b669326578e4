"""``plan_single_stroke``: pick an object up, turn or move it on one grasp, put it down.

Turns about the vertical come easily to hands: tips roll around the object. Where the object is
tilted or moved, tips may pivot on their contacts instead; the pivot is bounded here. The fallback
schedule tells which fingers and pads are tried in turn, and how far beyond the angle they turn.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from planner.errors import TaskError
from planner.failure import Failure
from planner.forces import ForceLoop
from planner.motion.context import OUT_OF_REACH, tripods, with_rolling_pads
from planner.motion.ending import Rests, planned_ending
from planner.motion.on_arm import OnArm, carried_ways
from planner.motion.path import (
    LARGEST_TURN,
    AnyAttitude,
    ObjectPath,
    check_place,
    checked_axis,
    checked_shift,
    tilts,
)
from planner.motion.plan import ManipulationPlan, MovementPlan
from planner.motion.search import MotionAttempt, motion_attempts
from planner.motion.task import with_fingers
from planner.motion.verify import FALLS, pressed
from planner.search.attempt import nothing_found
from planner.spatial import FloatArray
from planner.synthesis.seeds import turning_seeder_for
from planner.system.threads import made_once
from planner.task import GraspTask
from planner.verification import force_arguments

CANDIDATES = 3
"""Plans of which the best is taken, unless one is good enough to be taken at once; fewer where the
schedule gives no more."""

GOOD_RESERVE, GOOD_MARGIN = 0.1, 0.15
"""Share of its limit that every actuator keeps, and margin of closure (-), with which a plan is
good enough. The reserve moves the fingers and answers pushes, slips and an object beside its
planned place."""

GOOD_PRESS = 7.5
"""Largest normal force (N) in an attitude and on the way there with which a plan is good enough:
the closed loop may ask for 1.6 times as much."""

GOOD_ON_BALLS = 0.4
"""Margin of closure (-) with which a plan for a ball is good enough, whatever its reserve. Below it
one finger opposes another with most of the force, and torsional friction of the pivoting tips holds
the ball back; above it all fingers press alike."""

TURN_TOLERANCE, TILT_TOLERANCE, SHIFT_TOLERANCE = 0.03, 0.01, 0.0
"""Default path tolerance (m) of turns about the vertical, of tilts, and of translations. An object
that is tilted or moved is to end where it was asked to. A turn about the vertical gains angle by
the tolerance: a finger follows a face a third of the way around and cannot go as far to the side.
"""

MAX_ATTEMPTS = 50
"""Attempts before giving up."""

MOST_PIVOT = math.radians(12.0)
"""Most (rad) that a tip may pivot while the object is tilted or moved. With more,
torsional friction may stop the object short of its target."""

FALLEN = 12
"""Grasps that hold palm down but not in the attitude after which the search ends if none did: some
seconds. A Shadow-type hand had up to 6 before its first plan."""

OVERSHOOT, TIPS_OVERSHOOT, LEAST_OVERSHOOT = (math.radians(degrees) for degrees in (8.0, 5.0, 2.0))
"""Planned overshoot (rad) of the turn. A grasp made beside its planned place meets a joint limit
early, and the reference of an object that lags continues into the overshoot. Objects that turn the
fingertips along (``Shape.turns_tips``) get less, because hands can hardly turn wide ones further.
The least is for the last resort, and for turns by several strokes, whose last stroke makes up for
what is missing."""

FIRST, FIRST_TIPS, LATER = 3, 6, 8
"""Attempts of the first entry, of the first entry for objects that turn the tips along, whose
starts hold less often, and of each later entry."""


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
    """The entries in the order in which they are tried.

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
            # a fourth finger would have to go all the way as well: on a block it stays on its face
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


def plan_single_stroke(
    task: GraspTask,
    *,
    axis: Sequence[float] | FloatArray = (0.0, 0.0, 1.0),
    angle: float,
    shift: Sequence[float] | FloatArray = (0.0, 0.0, 0.0),
    place: tuple[float, float] | None = None,
    path_tolerance: float | None = None,
    seed: int = 0,
    max_attempts: int = MAX_ATTEMPTS,
    rests: Rests | None = None,
    attitude: AnyAttitude = "down",
) -> ManipulationPlan:
    """Plan a manipulation on one grasp.

    Args:
        task: What stands where, on a table, and the hand. Where it may spare fingers, plans are
            tried with one less too (``fallback_schedule``), and the plan's task has the chosen.
        axis: Axis of the turn (3,), world.
        angle: Turn in the hand, rad, with its sign.
        shift: Translation in the hand (3,), m, world, evenly along the turn.
        place: Where the object is to stand, x and y in m, world; where it was if None.
        path_tolerance: How far the object may leave its path, m; if None ``TURN_TOLERANCE``, or
            ``TILT_TOLERANCE`` or ``SHIFT_TOLERANCE`` where it is tilted or moved.
        seed: Same seed, same plan.
        max_attempts: Budget in attempts, for each attitude that an arm can choose from.
        rests: Tells whether an object stays where a task has it, as ``sim.manipulation.rests``;
            None takes geometry alone.
        attitude: As for ``plan_motion``.

    Raises:
        NoGraspFoundError: The budget ended.
        TaskError: No table, or what ``plan_motion`` refuses.
    """
    if task.table_height is None:
        raise TaskError("there is no table to pick from and to place on; give table_height")
    if max_attempts < 1:
        raise TaskError(f"max_attempts is {max_attempts}; give at least 1")
    direction, moved = checked_axis(axis), checked_shift(shift)
    check_place(place)
    if path_tolerance is None:
        turning = TILT_TOLERANCE if tilts(direction) else TURN_TOLERANCE
        path_tolerance = SHIFT_TOLERANCE if moved.any() else turning
    made: list[MotionAttempt] = []
    tried: list[tuple[str, ...]] = []
    for alone, turned, on_arm, reaches in carried_ways(task, attitude):
        asked = ObjectPath(axis=direction, angle=angle, shift=moved, attitude=turned)
        found: list[ManipulationPlan] = []
        fallen, stopped, budget = 0, False, len(made) + max_attempts
        for fallback in fallback_schedule(alone):
            attempts = fallback.attempts
            done = len(made) >= budget or (fallen >= FALLEN and not found)
            if done or good_enough(found) or (attempts is None and found):
                break
            tried.append(fallback.task.finger_names)
            path = _with_overshoot(asked, fallback.overshoot)
            most = budget if attempts is None else min(budget, len(made) + attempts)
            for attempt in motion_attempts(
                fallback.task,
                path,
                path_tolerance=path_tolerance,
                seed=seed,
                reaches=reaches,
            ):
                fell = fallen >= FALLEN and not found
                if len(made) >= most or good_enough(found) or fell:
                    break
                made.append(attempt)
                if attempt.plan is None:
                    failure = attempt.failure
                    fallen += failure is not None and failure.kind == FALLS
                    stopped |= failure is not None and failure.kind == OUT_OF_REACH
                    continue
                whole = pivots(attempt.plan) or whole_plan(
                    attempt.plan, on_arm, angle, place, shift=moved, rests=rests
                )
                if isinstance(whole, Failure):
                    made[-1], stopped = replace(attempt, plan=None, failure=whole), True
                    continue
                found.append(whole)
        if found:
            best = max(found, key=merit)
            record = replace(best.record, attempts=len(made), cpu_s=sum(a.cpu_s for a in made))
            return replace(best, record=record)
        if not stopped:  # the hand's own limits are the same in every attitude of the arm's choice
            break
    if fallen >= FALLEN:
        raise nothing_found(
            f"grasp of {task.object.name} by {task.hand.name} that holds it while the "
            "wrist turns: it falls in this attitude",
            made,
            "Try another attitude, a lighter object, more friction or other fingers",
        )
    sets = " or ".join(", ".join(names) for names in dict.fromkeys(tried))
    raise nothing_found(
        f"way to turn or move {task.object.name} by {asked} with {task.hand.name} ({sets})",
        made,
        "Try a smaller turn, a larger path tolerance, other fingers or more attempts",
    )


def whole_plan(
    motion: MovementPlan,
    on_arm: OnArm | None,
    angle: float,
    place: tuple[float, float] | None,
    *,
    shift: FloatArray | None = None,
    rests: Rests | None = None,
) -> ManipulationPlan | Failure:
    """A movement with its ending, made by the arm that the hand is on; or why there is none.

    Args:
        motion: Of one stroke or several, by the hand alone.
        on_arm: The arm; None where the base is free.
        angle: Requested turn, rad.
        place: As for ``plan_single_stroke``.
        shift: Requested translation in the hand (3,), m, world; none if None.
        rests: As for ``plan_single_stroke``.
    """
    carried = motion if on_arm is None else on_arm.carried(motion)
    if isinstance(carried, Failure):
        return carried
    ending = planned_ending(carried, angle, place, rests=rests)
    if isinstance(ending, Failure):
        return ending
    if ending.back and motion.cycles > 1:
        return Failure(kind="falls", text=ending.back)  # regrasps are not made backwards
    if on_arm is not None and (blocked := on_arm.blocked(carried, ending)):
        return blocked
    moved = np.zeros(3) if shift is None else shift
    return ManipulationPlan.of(carried, ending, angle=angle, shift=moved)


def good_enough(found: Sequence[ManipulationPlan]) -> bool:
    """Whether it is time to take the best of what was found."""
    return len(found) >= CANDIDATES or any(merit(p) >= 1.0 for p in found)


def merit(plan: ManipulationPlan) -> float:
    """How good a plan is (-), from 1 on good enough to be taken at once."""
    if plan.task.object.shape.ball_like:
        return plan.margin / GOOD_ON_BALLS
    good = min(plan.reserve / GOOD_RESERVE, plan.margin / GOOD_MARGIN)
    if not plan.path.turns_wrist:
        return good
    solved = [one for knot in plan.knots for one in (knot.forces, *knot.on_the_way)]
    return min(good, GOOD_PRESS / max(turning_press(plan), *map(pressed, solved)))


@made_once(CANDIDATES + 1)
def turning_press(motion: MovementPlan) -> float:
    """Largest normal force (N) of a stroke in its attitude against tips that pivot; inf if none do.

    A tip that pivots turns the object along. The others bear that torque by tangential forces, for
    which they press harder, and the tip presses harder against them.
    """
    task = motion.path.borne(replace(motion.task, table_height=None, obstacles=()))
    most = 0.0
    for knot, spin in zip(motion.knots, motion.spins, strict=True):
        now: Any = force_arguments(task, knot.contacts, motion.T_world_base, knot.q)
        limits = {key: now.pop(key) for key in ("actuation", "min_normal", "friction_scale")}
        step = ForceLoop(knot.contacts, **limits).step(now.pop("wrench"), spin=spin, **now)
        most = max(most, float(step.forces[:, 0].max()) if step.balanced else math.inf)
    return most


def _with_overshoot(asked: ObjectPath, overshoot: float) -> ObjectPath:
    """The path asked for with an overshoot (rad) of the turn, and the same share of translation."""
    angle = asked.angle
    if angle == 0.0:
        return asked
    turn = max(abs(angle), min(abs(angle) + overshoot, LARGEST_TURN))
    whole = math.copysign(turn, angle)
    return replace(asked, angle=whole, shift=whole / angle * asked.shift)


def pivots(motion: MovementPlan) -> Failure | None:
    """Which tip pivots too far on its contact when the object is tilted or moved, None for none.

    Torsional friction, which the controller does not model, would hold the object back.
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
