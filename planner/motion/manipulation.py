"""``plan_manipulation``: pick an object up, turn or move it in the hand, put it down.

    task = manipulation_task("allegro_hand", parse_object("cylinder:0.03x0.08"), mu=0.45)
    plan = plan_manipulation(task, angle=math.radians(90.0), place=(0.1, 0.05))

The movement has one stroke (``planner.motion.single_stroke``), or several with regrasps between
(``planner.motion.gait``); approach and ending are the same. ``sim.manipulate`` executes it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from planner.arrays import checked_number
from planner.errors import NoGraspFoundError, PlannerError, TaskError
from planner.failure import Failure
from planner.motion.ending import Rests, planned_ending, stands
from planner.motion.gait import plan_gait
from planner.motion.on_arm import carried_ways
from planner.motion.path import (
    LARGEST_TURN,
    AnyAttitude,
    check_place,
    checked_attitude,
    checked_axis,
    checked_shift,
    tilts,
)
from planner.motion.phase import Ending
from planner.motion.plan import ManipulationPlan, MovementPlan
from planner.motion.single_stroke import (
    LEAST_OVERSHOOT,
    MAX_ATTEMPTS,
    merit,
    plan_single_stroke,
    whole_plan,
)
from planner.motion.task import SEEDS_APART, manipulation_task, on_stand
from planner.spatial import FloatArray
from planner.task import GraspTask

__all__ = [
    "Ending",
    "ManipulationPlan",
    "Rests",
    "manipulation_of",
    "manipulation_task",
    "on_stand",
    "plan_manipulation",
    "plan_regrasping",
    "plan_single_stroke",
    "planned_ending",
]

ONE_STROKE = math.radians(150.0)
"""Turn (rad) about the vertical beyond which regrasps are planned first: one stroke hardly ever
goes so far, and its attempts would use up the budget."""

GAITS = 4
"""Gaits that are planned until the hand can let go at the end of one."""


def plan_regrasping(
    task: GraspTask,
    *,
    axis: Sequence[float] | FloatArray = (0.0, 0.0, 1.0),
    angle: float,
    place: tuple[float, float] | None = None,
    seed: int = 0,
    max_attempts: int = MAX_ATTEMPTS,
    rests: Rests | None = None,
    attitude: AnyAttitude = "down",
) -> ManipulationPlan:
    """Plan a turn by strokes and regrasps, with approach and ending.

    Args:
        task: What stands where, on a table, and the hand; all its fingers take part where the task
            leaves the choice.
        axis: Axis of the turn (3,), world; the object must look the same all around it.
        angle: Turn in the hand, rad, with its sign, of any size.
        place: Where the object is to stand, x and y in m, world; where it was if None.
        seed: Same seed, same plan.
        max_attempts: Budget in attempts, of each gait.
        rests: As for ``plan_manipulation``.
        attitude: As for ``plan_manipulation``.

    Raises:
        NoGraspFoundError: The budget ended.
        TaskError: No table, or what ``plan_gait`` refuses.
    """
    if task.table_height is None:
        raise TaskError("there is no table to pick from and to place on; give table_height")
    checked_number("angle", angle, unit="rad", error=TaskError)
    check_place(place)
    why: list[str] = []
    attempts, cpu_s = 0, 0.0
    for alone, turned, on_arm, reaches in carried_ways(task, attitude):
        for again in range(GAITS):
            try:
                gait = plan_gait(
                    alone,
                    axis=axis,
                    angle=math.copysign(abs(angle) + LEAST_OVERSHOOT, angle),
                    seed=seed + again * SEEDS_APART,
                    max_attempts=max_attempts,
                    attitude=turned,
                    reaches=reaches,
                )
            except NoGraspFoundError as error:
                if on_arm is None:
                    raise
                why.append(str(error))  # each attitude that the arm reaches is a draw of its own
                break
            attempts, cpu_s = attempts + gait.record.attempts, cpu_s + gait.record.cpu_s
            whole = whole_plan(gait, on_arm, angle, place, rests=rests)
            if isinstance(whole, Failure):
                why.append(whole.text)
                continue
            return replace(whole, record=replace(gait.record, attempts=attempts, cpu_s=cpu_s))
    raise NoGraspFoundError(
        f"{len(why)} gaits of {task.object.name} with {task.hand.name} cannot be made from where "
        f"it stands to where it is put down: {'; '.join(dict.fromkeys(why))}. Try another seed, a "
        "higher object, another place or other fingers",
        (),
    )


def plan_manipulation(
    task: GraspTask,
    *,
    axis: Sequence[float] | FloatArray = (0.0, 0.0, 1.0),
    angle: float,
    shift: Sequence[float] | FloatArray = (0.0, 0.0, 0.0),
    place: tuple[float, float] | None = None,
    seed: int = 0,
    max_attempts: int = MAX_ATTEMPTS,
    regrasp: bool = False,
    rests: Rests | None = None,
    attitude: AnyAttitude = "down",
) -> ManipulationPlan:
    """Pick an object from a table, turn or move it in the hand, put it down: planned whole.

    In one stroke if there is one, else with regrasps; beyond ``ONE_STROKE`` regrasps come first. In
    another attitude a stroke that presses hard is left for regrasps, by all fingers, that do not.

    Args:
        task: What stands where, on a table, and the hand, as from ``manipulation_task``. If it
            may spare fingers, sets with one finger less are tried too; the plan's task has the
            chosen set.
        axis: Axis of the turn (3,), world.
        angle: Turn in the hand, rad, with its sign, of any size.
        shift: Translation in the hand (3,), m, world, evenly along the turn; excludes
            regrasps.
        place: Where the object is to stand, x and y in m, world; where it was if None.
        seed: Same seed, same plan.
        max_attempts: Budget in attempts.
        regrasp: Whether to plan regrasps without looking for one stroke.
        rests: Whether an object stays where a task has it, as ``sim.manipulation.rests``. Without
        it
            geometry alone decides, and fewer objects stand turned on a stand.
        attitude: Of the hand while it turns or moves the object: "down" as it grasps, "sideways",
            "up" (palm up), or the rotation (3, 3) from the grasp to there, world. Axis, angle and
            shift are told for the hand as it grasps, and turn with it.

    Raises:
        NoGraspFoundError: The budget ended; carries the failures of strokes and of regrasps.
        TaskError: No table; no turn and no translation; or a translation with regrasps.
    """
    checked_number("angle", angle, unit="rad", error=TaskError)
    check_place(place)
    moved = bool(checked_shift(shift).any())
    if moved and (regrasp or abs(angle) > LARGEST_TURN):
        raise TaskError(
            "a translation in the hand is made in one stroke, without regrasps; leave the "
            "translation or the regrasps out, and turn by half a turn at most"
        )
    direction = checked_axis(axis)
    checked_attitude(attitude)
    asked: dict[str, Any] = {
        "axis": axis,
        "angle": angle,
        "place": place,
        "seed": seed,
        "max_attempts": max_attempts,
        "rests": rests,
        "attitude": attitude,
    }
    stroke = partial(plan_single_stroke, task, shift=shift, **asked)
    strokes = partial(plan_regrasping, task, **asked)
    if regrasp or abs(angle) > LARGEST_TURN:
        return strokes()
    if abs(angle) > ONE_STROKE and not (moved or tilts(direction)):
        try:
            return strokes()
        except PlannerError as error:
            no_regrasps = error
        try:
            return stroke()
        except NoGraspFoundError as error:
            raise _neither(error, no_regrasps) from no_regrasps
    made: ManipulationPlan | None = None
    try:
        made = stroke()
        if not made.path.turns_wrist or merit(made) >= 1.0:
            return made
    except NoGraspFoundError as error:
        no_stroke = error
    unit = direction / np.linalg.norm(direction)
    if moved or not stands(task, unit, angle, rests=rests):
        if made is not None:
            return made
        raise no_stroke
    try:
        several = strokes()
    except PlannerError as error:
        if made is not None:
            return made
        raise _neither(no_stroke, error) from error
    return several if made is None else max(made, several, key=merit)


def _neither(one_stroke: NoGraspFoundError, regrasps: PlannerError) -> NoGraspFoundError:
    """The error of a turn that neither one stroke nor regrasps achieve."""
    return NoGraspFoundError(f"{one_stroke}. With regrasps: {regrasps}", one_stroke.attempts)


def manipulation_of(
    movement: MovementPlan,
    *,
    place: tuple[float, float] | None = None,
    rests: Rests | None = None,
) -> ManipulationPlan:
    """A movement with an ending: pick the object up, move it as planned, put it down.

    Args:
        movement: Of one stroke or several; all of it is requested, there is no overshoot.
        place: Where the object is to stand, x and y in m, world; where it was if None.
        rests: As for ``plan_manipulation``.

    Raises:
        TaskError: No table, or the object cannot be put down at its end.
    """
    check_place(place)
    angle = movement.planned_angle
    if movement.task.table_height is None:
        raise TaskError("there is no table to pick from and to place on; plan with table_height")
    ending = planned_ending(movement, angle, place, rests=rests)
    if isinstance(ending, Failure) or (movement.cycles > 1 and ending.back):
        why = ending.text if isinstance(ending, Failure) else ending.back
        raise TaskError(f"the object cannot be put down at the end: {why}; plan another motion")
    return ManipulationPlan.of(movement, ending, angle=angle, shift=movement.planned_shift)
