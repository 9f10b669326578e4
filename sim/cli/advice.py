"""What to do with an object that is not grasped: another stable pose, a stand, or another size.

What is advised was tried: a grasp was found there in a few attempts.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from planner.errors import NoGraspFoundError
    from planner.plan import GraspPlan
    from planner.search.grasp import Attempt
    from planner.shapes.hulls import StablePose
    from planner.synthesis.options import SynthesisOptions
    from planner.task import GraspTask

LOW = 2.0
"""Height of an object over the thickness of a fingertip (-) below which it may be too low. The
Allegro-type hand, 24 mm, fails at plates of 12 and 15 mm and grasps those of 20 mm."""

HIGHER = 1.2
"""Height of another pose over the present one (-) from which it is worth trying."""

MOST_POSES, ATTEMPTS = 6, 30
"""Poses that are tried, and most attempts at each: some tens of ms of CPU per attempt."""

FACTORS, QUICK = (0.8, 1.25, 0.65, 1.5), 12
"""Sizes that are tried over the given one (-), the nearest first, and most attempts at each."""

STANDS = (0.03, 0.05)
"""Heights (m) of stands that are tried: about one and two fingertips."""


def advice_for_low(
    task: GraspTask,
    *,
    pose: int | None,
    options: SynthesisOptions,
    seed: int = 0,
    max_attempts: int = ATTEMPTS,
    progress: Callable[[Attempt[GraspPlan]], object] | None = None,
) -> str | None:
    """What would do for a task that failed: a sentence, or None if height is not what is missing.

    Args:
        task: An object in a stable pose on a table, for which no grasp was found.
        pose: Which of the stable poses that is; None where the command takes no other, and it is
            the first.
        options: What synthesis was asked for.
        seed: Of the search that failed: with the same one the advice, followed, finds its grasp.
        max_attempts: Budget of that search; no more are spent on any one remedy, nor more than
            ``ATTEMPTS``.
        progress: Called after every attempt.
    """
    thick = 2 * max(finger.pad.radius for finger in task.fingers)
    poses = task.object.shape.resting_poses()
    height = _height(task, poses[pose or 0])
    if task.table_height is None or height >= LOW * thick:
        return None
    lies = (
        f"it lies {1e3 * height:.0f} mm high on the table, and a fingertip of {task.hand.name} is "
        f"{1e3 * thick:.0f} mm thick"
    )

    others = () if pose is None else _poses(task, poses, HIGHER * height)
    budget = min(ATTEMPTS, max_attempts)
    for remedy, other in (*others, *_stands(task)):
        if _is_found(other, budget, seed, options, progress):
            return f"{lies}; {remedy}"
    return None


def advice_for_size(
    task: GraspTask,
    *,
    pose: int | None,
    options: SynthesisOptions,
    seed: int = 0,
    max_attempts: int = QUICK,
    progress: Callable[[Attempt[GraspPlan]], object] | None = None,
) -> str | None:
    """Another pose or the nearest size that a few attempts grasp: a sentence, or None.

    Args:
        task: For which no grasp was found.
        pose: Which stable pose the object is in; None where it is in another one, or stands free.
        options: What synthesis was asked for.
        seed: Of the search that failed.
        max_attempts: Of that search: no more are made for each pose and size.
        progress: Called after every attempt.
    """
    for remedy, other in (*_other_poses(task, pose), *_sizes(task)):
        if _is_found(other, min(QUICK, max_attempts), seed, options, progress):
            return remedy
    return None


def _is_found(
    task: GraspTask,
    budget: int,
    seed: int,
    options: SynthesisOptions,
    progress: Callable[[Attempt[GraspPlan]], object] | None,
) -> bool:
    """Whether so many attempts find a grasp."""
    from planner.errors import PlannerError
    from planner.search.grasp import plan_grasp

    try:
        plan_grasp(task, seed=seed, max_attempts=budget, options=options, progress=progress)
    except PlannerError:  # none found; too wide so, or an obstacle in the way
        return False
    return True


def _other_poses(task: GraspTask, pose: int | None) -> Iterator[tuple[str, GraspTask]]:
    """The task with the object in other stable poses on its table."""
    if task.table_height is None or pose is None:
        return
    poses = task.object.shape.resting_poses()
    for k in [k for k in range(len(poses)) if k != pose][: MOST_POSES // 2]:
        yield f"In pose {k} a grasp was found: --pose {k}", _placed(task, poses[k])


def _sizes(task: GraspTask) -> Iterator[tuple[str, GraspTask]]:
    """The task with its object in other sizes, in the same place and pose."""
    from planner.errors import ObjectError, TaskError
    from planner.shapes import Mesh, Shape

    shape = task.object.shape
    for factor in FACTORS:
        other: Shape
        try:
            if shape.sizes:
                other = type(shape).from_sizes([round(factor * s, 6) for s in shape.sizes])
                name = other.spec
            elif isinstance(shape, Mesh) and shape.source is not None:
                other = Mesh(factor * shape.vertices, shape.faces)
                name = f"{shape.source.path}*{factor * shape.source.scale:g}"
            else:
                return
            pose, table = task.T_world_object.copy(), task.table_height
            if table is not None:  # it stands where it stood
                pose.translation[2] = table + factor * (pose.translation[2] - table)
            item = replace(task.object, shape=other)
            sized = replace(task, object=item, T_world_object=pose)
        except (ObjectError, TaskError):  # a size that does not go, or an obstacle in the way
            continue
        yield f"In {factor:g} times the size a grasp was found: {name}", sized


def _placed(task: GraspTask, pose: StablePose) -> GraspTask:
    """The task with its object in a stable pose where it stands on the table."""
    from planner.spatial import SE3

    place = task.T_world_object.translation.copy()
    place[2] = (task.table_height or 0.0) + pose.height
    return replace(task, T_world_object=SE3(pose.rotation, place))


def said_of_low(error: NoGraspFoundError, task: GraspTask, advice: str) -> NoGraspFoundError:
    """The error with the advice in place of the residuals of terms."""
    from planner.errors import NoGraspFoundError

    return NoGraspFoundError(
        f"no grasp of {task.object.name} with {task.hand.name} in {len(error.attempts)} attempts: "
        f"{advice}",
        error.attempts,
    )


def _poses(
    task: GraspTask, poses: tuple[StablePose, ...], least: float
) -> Iterator[tuple[str, GraspTask]]:
    """The task with the object in other poses, those that fall last first."""
    higher = [k for k, pose in enumerate(poses) if _height(task, pose) >= least]
    for k in higher[:MOST_POSES]:
        yield (
            f"pose {k} stands {1e3 * _height(task, poses[k]):.0f} mm high and a grasp was found: "
            f"--pose {k}",
            _placed(task, poses[k]),
        )


def _stands(task: GraspTask) -> Iterator[tuple[str, GraspTask]]:
    """The task with its object on stands; nothing where there are obstacles already."""
    from planner.errors import TaskError
    from planner.motion.manipulation import on_stand

    for height in () if task.obstacles else STANDS:
        try:
            raised = on_stand(task, height)
        except TaskError:  # too small for the walls
            return
        yield (
            f"on a stand of {1e3 * height:.0f} mm a grasp was found: --stand {height:g}",
            raised,
        )


def _height(task: GraspTask, pose: StablePose) -> float:
    """Height (m) of the object's top above the table in a stable pose."""
    return pose.height + task.object.shape.support(pose.rotation[2])
