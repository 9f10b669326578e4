"""``plan_regrasping``: pick, turn by any angle in several strokes, place; ``plan_turning`` chooses.

The turn is a ``planner.gait.GaitPlan``: strokes of one motion, and between them the fingers move on
one at a time. Way in, way out and target are those of any ``ManipulationPlan``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from planner.errors import NoGraspFoundError, PlannerError, TaskError
from planner.gait import plan_gait
from planner.motion.path import LARGEST_TURN
from planner.motion.release import find_release
from planner.spatial import FloatArray
from planner.task import GraspTask
from sim.manipulation.plan import (
    LITTLE_MORE,
    MAX_ATTEMPTS,
    ManipulationPlan,
    object_at_target,
    plan_manipulation,
    standing_under,
    torque_reserve,
)

__all__ = ["plan_regrasping", "plan_turning"]

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
        release = find_release(gait.motion)
        if isinstance(release, str):
            why = release
            continue
        target = object_at_target(task, gait.motion.path.axis, angle, place)
        return ManipulationPlan(
            motion=gait.motion,
            angle=angle,
            T_world_target=target,
            under_target=standing_under(task, target),
            release=release,
            reserve=torque_reserve(gait.motion),
            attempts=attempts,
            cpu_s=cpu_s,
            gait=gait,
        )
    raise NoGraspFoundError(
        f"{GAITS} gaits of {task.object.name} with {task.hand.name} end where the hand cannot let "
        f"go: {why}. Try another seed, a higher object or other fingers",
        (),
    )


def plan_turning(
    task: GraspTask,
    *,
    axis: Sequence[float] | FloatArray = (0.0, 0.0, 1.0),
    angle: float,
    place: tuple[float, float] | None = None,
    seed: int = 0,
    max_attempts: int = MAX_ATTEMPTS,
    regrasp: bool = False,
) -> ManipulationPlan:
    """A turn in one stroke if there is one, else with regrasps.

    Args:
        task: As for ``plan_manipulation``.
        axis: As there.
        angle: As there, of any size.
        place: As there.
        seed: As there.
        max_attempts: As there.
        regrasp: Whether to plan regrasps without looking for one stroke first.

    Raises:
        NoGraspFoundError: There is neither; it tells both reasons.
        TaskError: As there.
    """
    if regrasp or abs(angle) > LARGEST_TURN:
        return plan_regrasping(
            task, axis=axis, angle=angle, place=place, seed=seed, max_attempts=max_attempts
        )
    try:
        return plan_manipulation(
            task, axis=axis, angle=angle, place=place, seed=seed, max_attempts=max_attempts
        )
    except NoGraspFoundError as error:
        one_stroke = error
    try:
        return plan_regrasping(
            task, axis=axis, angle=angle, place=place, seed=seed, max_attempts=max_attempts
        )
    except PlannerError as error:
        raise NoGraspFoundError(
            f"{one_stroke}. With regrasps: {error}", one_stroke.attempts
        ) from error
