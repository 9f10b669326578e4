"""``plan_gait``: strokes of a motion, and between them an order in which the fingers move on.

A stroke is a motion (``planner.motion``) that ends with the object on its path. It is planned so
that the opposing finger can be lifted when the trailing fingers have moved on and the leading ones
have not: at that time the fingers reach around more of the object than at any other. Then all
orders of lifts are searched (``planner.motion.order``). The hand repeats the same postures in
every cycle, so the object must look the same to it after a stroke: a solid of revolution about its
axis, or a prism along itself. This is verified cycle by cycle, not assumed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from planner.arrays import checked_number
from planner.errors import NoGraspFoundError, TaskError
from planner.kinematics import HandState
from planner.motion.context import MotionContext, Reaches, attempts_in_turn
from planner.motion.order import NO_ORDER, Lift, NoOrder, Order, find_order
from planner.motion.path import (
    AnyAttitude,
    ObjectPath,
    checked_attitude,
    checked_axis,
    checked_shift,
)
from planner.motion.phase import Relocation, Stroke
from planner.motion.plan import GaitPlan, MovementPlan
from planner.motion.regrasp import cut_motion, plan_back, plan_others
from planner.motion.search import MOTION_OPTIONS, PATH_TOLERANCE, UP, check_task
from planner.motion.terms import Stance
from planner.search.attempt import Attempt, nothing_found, search
from planner.spatial import FloatArray
from planner.synthesis.options import SynthesisOptions
from planner.synthesis.seeds import seeder_for
from planner.synthesis.seeds.opposition import frame_of
from planner.task import GraspTask

__all__ = [
    "GaitPlan",
    "Lift",
    "NoOrder",
    "Order",
    "Relocation",
    "Stroke",
    "cut_motion",
    "find_order",
    "plan_back",
    "plan_gait",
    "plan_others",
]

STROKES = tuple(np.deg2rad([30.0, 24.0, 36.0, 20.0]))
"""Angles (rad) of a stroke unless told; attempts alternate between them. Longer strokes need fewer
cycles, shorter ones leave the fingers more room to reach around the object while one is away."""

STROKE_SHIFT = 0.01
"""Translation (m) of a stroke."""

N_KNOTS = 3
"""Knots of the solver in a stroke: at most 18 degrees apart, 20 in a gait of one stroke."""

MAX_ATTEMPTS = 30
"""Attempts before giving up."""


def plan_gait(
    task: GraspTask,
    *,
    axis: Sequence[float] | FloatArray = UP,
    angle: float = 0.0,
    shift: Sequence[float] | FloatArray = (0.0, 0.0, 0.0),
    path_tolerance: float = PATH_TOLERANCE,
    seed: int = 0,
    max_attempts: int = MAX_ATTEMPTS,
    strokes: Sequence[float] = STROKES,
    options: SynthesisOptions = MOTION_OPTIONS,
    attitude: AnyAttitude = "down",
    reaches: Reaches | None = None,
) -> MovementPlan:
    """A motion of the object in the hand that is longer than one grasp allows, by regrasping.

    May be called from any number of threads, like ``plan_grasp``.

    Args:
        task: What is grasped, with what, where it stands at the start; the base is free. All
            fingers of the hand take part where the task leaves the choice, and contacts may be
            wherever tips are round (``Hand.rolling``).
        axis: Axis of the turn through the object's centre of mass (3,), world.
        angle: Turn, rad, with its sign, of any size.
        shift: Translation (3,), m, world.
        path_tolerance: How far the object may leave its path during a stroke, m.
        seed: Same seed, same plan.
        max_attempts: Budget in attempts.
        strokes: Angles (rad) of about which a stroke is; attempts alternate between them.
        options: Margins and weights at each knot.
        attitude: As for ``plan_motion``.
        reaches: As for ``motion_attempts``.

    Raises:
        NoGraspFoundError: The budget ended; carries every attempt and its failure.
        TaskError: The task or the path cannot work, found out before solving.
    """
    if max_attempts < 1:
        raise TaskError(f"max_attempts is {max_attempts}; give at least 1")
    # contacts of a gait reach the rims of the pads of a grasp
    task = _with_all(replace(task, hand=task.hand.rolling))
    check_task(task, path_tolerance, seed)
    _check_fingers(task)
    shift = checked_shift(shift)
    pieces = _pieces(checked_axis(axis), angle, shift, checked_attitude(attitude), strokes)

    contexts = [
        partial(
            MotionContext.of,
            task,
            path,
            options,
            n_knots=N_KNOTS,
            full=True,
            path_tolerance=path_tolerance,
            exact_end=True,
            stances=_stances(task, path) if held and cycles > 1 else (),
            cycles=cycles,
            reaches=reaches,
        )
        for path, cycles, held in pieces
    ]
    plan, made = search(attempts_in_turn(contexts, seed), max_attempts=max_attempts)
    if plan is None:
        raise _nothing_found(task, pieces[0], made)
    return plan


def _with_all(task: GraspTask) -> GraspTask:
    """The task with all fingers of the hand, if it leaves the choice."""
    names = tuple(task.hand.fingers)
    if not task.may_spare_fingers or set(names) == set(task.finger_names):
        return task
    return task.with_fingers(names)


def _check_fingers(task: GraspTask) -> None:
    task.require_fingertips("a gait")
    n = len(task.fingers)
    if n - 1 < task.fingers_needed:
        raise TaskError(
            f"lifting one of {n} fingers leaves {n - 1} {task.contact_model} contacts, which never "
            f"close a grasp: it takes {task.fingers_needed}; give at least "
            f"{task.fingers_needed + 1} fingers"
        )


def _nothing_found(
    task: GraspTask, piece: tuple[ObjectPath, int, bool], made: list[Attempt[MovementPlan]]
) -> NoGraspFoundError:
    """The error of an exhausted budget, with the last failure of the lifts if any were tried."""
    path, cycles, _ = piece
    told = [a.failure for a in made if a.failure is not None and a.failure.kind == NO_ORDER]
    rare = 2 * len(told) < len(made)  # else the summary of failures shows one of them
    why = f"Of a stroke that was found, {told[-1]}\n" if told and rare else ""
    return nothing_found(
        f"regrasping of {task.object.name} with {task.hand.name} "
        f"({', '.join(task.finger_names)}) for {cycles} strokes of {path}",
        made,
        f"{why}Try more friction, another object, other fingers or more attempts",
    )


def _pieces(
    axis: FloatArray,
    angle: float,
    shift: FloatArray,
    attitude: FloatArray,
    strokes: Sequence[float],
) -> list[tuple[ObjectPath, int, bool]]:
    """What attempts alternate between: a stroke, the number of cycles, whether lifts are required.

    The last requires none, so that an error can tell which lifts fail after a stroke.
    """
    checked_number("angle", angle, least=-MOST_ANGLE, most=MOST_ANGLE, unit="rad", error=TaskError)
    counts: list[int] = []
    for turn in strokes:
        checked_number("stroke", turn, above=0.0, most=MOST_ANGLE, unit="rad", error=TaskError)
        pieces = max(abs(angle) / turn, float(np.linalg.norm(shift)) / STROKE_SHIFT)
        count = max(1, int(np.ceil(pieces - LONGER)))
        if count not in counts:
            counts.append(count)
    whole = [(angle / n, shift / n, n) for n in counts]
    paths = [
        (ObjectPath(axis=axis, angle=turn, shift=by, attitude=attitude), n) for turn, by, n in whole
    ]
    held = [(path, n, True) for path, n in paths]
    return held if counts == [1] else [*held, (*paths[0], False)]


MOST_ANGLE = 1e3
"""Largest turn (rad) that is cut into cycles: some 160 revolutions."""

SMALL = 1e-6
"""Length (-) below which a vector has no direction."""

LONGER = 0.1
"""Excess (-) over a whole number of strokes that lengthens them instead of adding a cycle."""


def _stances(task: GraspTask, path: ObjectPath) -> tuple[Stance, ...]:
    """The opposing finger away, those that trail moved on; none on a mesh, which has no formula."""
    seeder = seeder_for(task)
    if seeder.surface.field_of(task.object.shape) is not None:
        return ()
    n, opposer = len(task.fingers), seeder.pinch.opposer
    others = [i for i in range(n) if i != opposer]
    moved: set[int] = set()
    if path.angle:
        # as the hand comes from above without noise
        sideways = np.cross(path.axis, UP)
        across = sideways if np.linalg.norm(sideways) > SMALL else np.eye(3)[0]
        pinch = seeder.pinch
        turn = frame_of(across / np.linalg.norm(across), np.array(UP))
        turn = turn @ frame_of(pinch.axis, pinch.palm_side).T
        ahead = turn.T @ np.cross(np.sign(path.angle) * path.axis, turn @ pinch.axis)
        hand, state = task.hand, HandState(task.hand, seeder.posture)
        knuckles = [hand.pin_model.getJointId(f.joints[0]) for f in task.fingers]
        roots = [float(state.joint_pose(joint).translation @ ahead) for joint in knuckles]
        others.sort(key=lambda i: roots[i])
        moved = set(others[: len(others) // 2])
    return (Stance(swinging=opposer, knots=tuple(0 if i in moved else -1 for i in range(n))),)
