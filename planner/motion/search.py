"""``plan_motion``: draw a start, solve for all knots, verify each on the true geometry; repeat."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from planner.errors import NoGraspFoundError, TaskError
from planner.motion.context import (
    MotionContext,
    Reaches,
    attempts_in_turn,
    finger_sets,
    merit,
    with_rolling_pads,
)
from planner.motion.path import LARGEST_TURN, AnyAttitude, ObjectPath, checked_attitude
from planner.motion.plan import MovementPlan
from planner.search.attempt import Attempt, check_seed, nothing_found, search
from planner.spatial import FloatArray
from planner.synthesis.options import SynthesisOptions
from planner.task import GraspTask

MotionAttempt = Attempt[MovementPlan]
"""One attempt: a motion, or why there is none."""

PATH_TOLERANCE = 0.02
"""How far (m) the object may leave its path by default. With 10 mm the Shadow-type hand reaches 90
degrees on cylinders of 5, 6 and 7 cm from 4, 4 and 0 of 10 starts, with 20 mm from 5, 9 and 7
(thumb, index and middle)."""

KNOT_TURN, KNOT_SHIFT = np.deg2rad(30.0), 0.015
"""Most that the object turns (rad) or moves (m) between two knots of the solver. With 24 degrees 11
and 12 of the first 15 starts held in two cases, with 30 9 and 13, in a seventh less time."""

LONGEST_KNOTS = 6
"""Knots where as much as there is is asked for: up to 144 degrees were found, 29 between two."""

MOTION_OPTIONS = SynthesisOptions(weight_posture=0.05, weight_share=1.0)
"""A motion leaves the pinch posture by design: a grasp is asked six times as much to keep to it.
Normal forces are to be even, by ten times the weight: where every finger must press with the grip,
less is then asked of the strongest."""

ROUNDS = 1
"""Rounds that work on closure at all knots where the best of several motions is asked for. They
raise the least margin by up to a quarter, but not always, and cost as much as the first descent: so
there are both, and the better one is taken."""

BEST_OF = 6
"""Motions of which the longest path is taken where as much as there is is asked for."""

MAX_ATTEMPTS = 30
"""Attempts before giving up."""

UP = (0.0, 0.0, 1.0)
"""Default axis, world."""


def motion_attempts(
    task: GraspTask,
    path: ObjectPath,
    *,
    full: bool = True,
    path_tolerance: float = PATH_TOLERANCE,
    seed: int = 0,
    improve_closure: bool = False,
    options: SynthesisOptions = MOTION_OPTIONS,
    reaches: Reaches | None = None,
) -> Iterator[MotionAttempt]:
    """Endless independent attempts; attempt i depends on ``seed`` and i alone.

    A single iterator is for one thread at a time.

    Args:
        task: What is grasped, with which fingers, where; the base is free. On objects with faces
            contacts may be wherever tips are round (``Hand.rolling``).
        path: Where the object is to go.
        full: Whether all of the path is asked for, else as much of it as there is.
        path_tolerance: How far the object may leave the path, m.
        seed: Same seed, same attempts.
        improve_closure: Whether to work on closure once all of the path is reached.
        options: Margins and weights at each knot.
        reaches: Whether what carries the hand brings its base there; anywhere if None.

    Raises:
        TaskError: The task or the path cannot work, found out before solving.
    """
    check_task(task, path_tolerance, seed)
    context = partial(
        MotionContext.of,
        with_rolling_pads(task),
        path,
        options,
        n_knots=_knots(path) if full else LONGEST_KNOTS,
        full=full,
        path_tolerance=path_tolerance,
        rounds=ROUNDS * improve_closure,
        reaches=reaches,
    )
    return attempts_in_turn([context], seed)


def plan_motion(
    task: GraspTask,
    *,
    axis: Sequence[float] | FloatArray = UP,
    angle: float | None = None,
    shift: Sequence[float] | FloatArray = (0.0, 0.0, 0.0),
    path_tolerance: float = PATH_TOLERANCE,
    seed: int = 0,
    max_attempts: int = MAX_ATTEMPTS,
    best_of: int | None = None,
    options: SynthesisOptions = MOTION_OPTIONS,
    attitude: AnyAttitude = "down",
) -> MovementPlan:
    """A motion of the object in the hand, without regrasping.

    May be called from any number of threads, like ``plan_grasp``.

    Args:
        task: What is grasped, with what, where it stands at the start; the base is free. Where it
            leaves the choice of fingers, attempts take turns between tripods and all of its fingers
            (``finger_sets``), and the task of the plan says with which it is.
        axis: Axis of the turn through the object's centre of mass (3,), world.
        angle: Turn, rad, with its sign; None for as much as there is, counted positive about
            ``axis``.
        shift: Translation of the object along the path (3,), m, world; over half a turn, and cut
            with it, where ``angle`` is None.
        path_tolerance: How far the object may leave the path, m.
        seed: Same seed, same plan.
        max_attempts: Budget in attempts.
        best_of: Motions to find, of which the best is taken: the longest path where ``angle`` is
            None, else the one with the largest margin of closure; fewer where the budget ends
            before. None for one where an angle is given and for ``BEST_OF`` where it is not.
        options: Margins and weights at each knot.
        attitude: Of the hand while it turns or moves the object: a name of ``ATTITUDES``, or the
            rotation (3, 3) from the grasp to there, world.

    Returns:
        The plan; it tells what limits it.

    Raises:
        NoGraspFoundError: The budget ended; carries every attempt and its failure.
        TaskError: The task or the path cannot work, or a budget is not positive.
    """
    if max_attempts < 1 or (best_of is not None and best_of < 1):
        raise TaskError(f"max_attempts is {max_attempts}, best_of {best_of}; give at least 1")
    full = angle is not None
    path = ObjectPath(
        axis=np.asarray(axis, dtype=np.float64),
        angle=LARGEST_TURN if angle is None else angle,
        shift=np.asarray(shift, dtype=np.float64),
        attitude=checked_attitude(attitude),
    )
    best_of = best_of or (1 if full else BEST_OF)
    check_task(task, path_tolerance, seed)
    contexts = [
        partial(
            MotionContext.of,
            one,
            path,
            options,
            n_knots=_knots(path) if full else LONGEST_KNOTS,
            full=full,
            path_tolerance=path_tolerance,
            rounds=ROUNDS * (best_of > 1),
        )
        for one in finger_sets(with_rolling_pads(task))
    ]
    best, made = search(
        attempts_in_turn(contexts, seed),
        max_attempts=max_attempts,
        best_of=best_of,
        merit=partial(merit, full=full),
    )
    if best is None:
        raise _nothing_found(task, path, made)
    return replace(
        best,
        record=replace(best.record, attempts=len(made), cpu_s=sum(a.cpu_s for a in made)),
    )


def _knots(path: ObjectPath) -> int:
    """Knots of the solver on a path."""
    turn, shift = abs(path.angle) / KNOT_TURN, float(np.linalg.norm(path.shift)) / KNOT_SHIFT
    return max(3, 1 + int(np.ceil(max(turn, shift) - ROUNDING)))


ROUNDING = 1e-9
"""A path longer than a whole number of pieces by this (-) has that number."""


LARGEST_TOLERANCE = 2.0
"""Largest path tolerance, m: as large as an object may be."""


def check_task(task: GraspTask, path_tolerance: float, seed: int) -> None:
    """Check what every motion needs.

    Raises:
        TaskError: The base or the wrist is not as it must be, or a number is out of range.
    """
    task.require_fingertips("a motion")
    if task.hand.arm is not None or task.T_world_base is not None:
        raise TaskError(
            f"the base of {task.hand.name} is fixed in this task; a motion is planned for a hand "
            "whose base is free, so leave T_world_base out and take a hand without an arm"
        )
    if task.wrist_free:
        raise TaskError("the wrist is free in this task; a motion is the fingers': hold the wrist")
    if not 0 <= path_tolerance <= LARGEST_TOLERANCE:
        raise TaskError(
            f"path_tolerance is {path_tolerance}; give a distance in m, 0 or more, up to "
            f"{LARGEST_TOLERANCE:g}"
        )
    check_seed(seed)


def _nothing_found(
    task: GraspTask, path: ObjectPath, made: list[MotionAttempt]
) -> NoGraspFoundError:
    return nothing_found(
        f"motion of {task.object.name} by {path} with {task.hand.name} "
        f"({' or '.join(', '.join(one.finger_names) for one in finger_sets(task))})",
        made,
        "Try a shorter path, a larger path tolerance, other fingers or more attempts; angle=None "
        "finds how far it goes and what limits it",
    )
