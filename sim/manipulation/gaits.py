"""``plan_regrasping``: pick, turn by any angle in several strokes, place; ``plan_turning`` chooses.

The turn is a ``planner.motion.gait.GaitPlan``: strokes of one motion, and between them the fingers
move on one at a time. Way in, way out and target are those of any ``ManipulationPlan``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from planner.errors import NoGraspFoundError, PlannerError, TaskError
from planner.failure import Failure
from planner.motion.gait import plan_gait
from planner.motion.path import LARGEST_TURN, tilts
from planner.spatial import FloatArray
from planner.task import GraspTask
from sim.manipulation.ending import planned_ending, standing_under, stands
from sim.manipulation.plan import (
    MAX_ATTEMPTS,
    ManipulationPlan,
    plan_manipulation,
    torque_reserve,
)
from sim.manipulation.rounds import LITTLE_MORE

__all__ = ["ONE_STROKE", "plan_regrasping", "plan_turning"]

ONE_STROKE = math.radians(150.0)
"""Turn (rad) about the vertical beyond which regrasps are planned first: one stroke was found to
turn by 144 degrees at most. A cylinder of 60 mm in the Allegro-type hand, 180 degrees: 50 attempts
at one stroke find nothing in 10 s of CPU, and the first gait that is tried holds."""

GAITS = 4
"""Gaits tried until one is found out of whose end the hand gets."""

SEEDS_APART = 1000
"""Their seeds lie so far apart: nobody's next seed gives a gait that was tried already."""


def plan_regrasping(
    task: GraspTask,
    *,
    axis: Sequence[float] | FloatArray = (0.0, 0.0, 1.0),
    angle: float,
    place: tuple[float, float] | None = None,
    seed: int = 0,
    max_attempts: int = MAX_ATTEMPTS,
) -> ManipulationPlan:
    """Plan a turn by strokes and regrasps, with the way to the object and the way from it.

    Args:
        task: What stands where, on a table, and the hand; all its fingers take part where the task
            leaves the choice.
        axis: Axis of the turn (3,), world; the object must look the same all around it.
        angle: Turn in the hand, rad, with its sign, of any size.
        place: Where the object is to stand, x and y in m, world; where it was if None.
        seed: Same seed, same plan.
        max_attempts: Budget in attempts, of each gait.

    Raises:
        NoGraspFoundError: The budget ended.
        TaskError: No table, or what ``plan_gait`` refuses.
    """
    if task.table_height is None:
        raise TaskError("there is no table to pick from and to place on; give table_height")
    why = ""
    attempts, cpu_s = 0, 0.0
    for again in range(GAITS):
        gait = plan_gait(
            task,
            axis=axis,
            angle=math.copysign(abs(angle) + LITTLE_MORE, angle),
            seed=seed + again * SEEDS_APART,
            max_attempts=max_attempts,
        )
        attempts, cpu_s = attempts + gait.record.attempts, cpu_s + gait.record.cpu_s
        ending = planned_ending(gait.motion, angle, place)
        if isinstance(ending, Failure) or ending.back:
            why = str(ending) if isinstance(ending, Failure) else ending.back
            continue
        return ManipulationPlan(
            motion=gait.motion,
            angle=angle,
            T_world_target=ending.T_world_target,
            under_target=standing_under(task, ending.T_world_target),
            release=ending.release,
            reserve=torque_reserve(gait.motion),
            attempts=attempts,
            cpu_s=cpu_s,
            gait=gait,
        )
    raise NoGraspFoundError(
        f"{GAITS} gaits of {task.object.name} with {task.hand.name} end where the object cannot be "
        f"put down: {why}. Try another seed, a higher object or other fingers",
        (),
    )


def plan_turning(
    task: GraspTask,
    *,
    axis: Sequence[float] | FloatArray = (0.0, 0.0, 1.0),
    angle: float,
    shift: Sequence[float] | FloatArray = (0.0, 0.0, 0.0),
    place: tuple[float, float] | None = None,
    seed: int = 0,
    max_attempts: int = MAX_ATTEMPTS,
    regrasp: bool = False,
) -> ManipulationPlan:
    """A turn in one stroke if there is one, else with regrasps; beyond ``ONE_STROKE`` these first.

    Args:
        task: As for ``plan_manipulation``.
        axis: As there.
        angle: As there, of any size.
        shift: As there; with one there are no regrasps.
        place: As there.
        seed: As there.
        max_attempts: As there.
        regrasp: Whether to plan regrasps without looking for one stroke.

    Raises:
        NoGraspFoundError: There is neither; it tells both reasons.
        TaskError: As there; or a translation is asked for with regrasps.
    """
    moved = bool(np.any(shift))
    if moved and (regrasp or abs(angle) > LARGEST_TURN):
        raise TaskError(
            "a translation in the hand is made in one stroke, without regrasps; leave the "
            "translation or the regrasps out, and turn by half a turn at most"
        )
    if regrasp or abs(angle) > LARGEST_TURN:
        return plan_regrasping(
            task, axis=axis, angle=angle, place=place, seed=seed, max_attempts=max_attempts
        )

    def stroke() -> ManipulationPlan:
        return plan_manipulation(
            task,
            axis=axis,
            angle=angle,
            shift=shift,
            place=place,
            seed=seed,
            max_attempts=max_attempts,
        )

    def regrasping() -> ManipulationPlan:
        return plan_regrasping(
            task, axis=axis, angle=angle, place=place, seed=seed, max_attempts=max_attempts
        )

    direction = np.asarray(axis, dtype=np.float64)
    beyond = abs(angle) > ONE_STROKE and not moved and not tilts(direction)
    if beyond:
        try:
            return regrasping()
        except PlannerError as error:
            reason = error
        try:
            return stroke()
        except NoGraspFoundError as error:
            raise _neither(error, reason) from reason
    try:
        return stroke()
    except NoGraspFoundError as error:
        one_stroke = error
    if moved or not stands(task, direction / np.linalg.norm(direction), angle):
        raise one_stroke
    try:
        return regrasping()
    except PlannerError as error:
        raise _neither(one_stroke, error) from error


def _neither(one_stroke: NoGraspFoundError, regrasps: PlannerError) -> NoGraspFoundError:
    """The error of a turn that neither one stroke nor regrasps make."""
    return NoGraspFoundError(f"{one_stroke}. With regrasps: {regrasps}", one_stroke.attempts)
