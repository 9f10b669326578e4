"""``Ending``: how an object that was turned or moved in the hand is put down.

The object is put down in its final attitude if it stands in it: after a turn about the vertical, a
turn onto its own symmetry, or a turn onto another stable face. The hand must also find a way out
there. Otherwise the motion is reversed first, and the object is put down as it was picked up.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
import pinocchio as pin

from planner.approach.pregrasp import Approach
from planner.collision.resting import lift_to_rest
from planner.failure import Failure
from planner.immutable import freeze
from planner.motion.plan import MotionPlan
from planner.motion.release import SINKS, find_release
from planner.spatial import SE3, FloatArray
from planner.task import GraspTask, Obstacle

Rests: TypeAlias = Callable[[GraspTask], bool]
"""Whether the object of a task stays where the task has it; ``sim.manipulation.rests`` is one."""

FLAT = np.cos(np.deg2rad(0.5))
"""Least cosine (-) between two directions that count as equal."""

ALIKE = 1e-4
"""Largest difference (m) of a solid's extents in two attitudes that count as equal."""

DIRECTIONS = 200
"""Number of directions in which the extents are compared."""

SAME_PLACE = 1e-6
"""Distance (m) below which two places are the same."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Ending:
    """How an object is put down.

    Attributes:
        T_world_target: Final pose of the object.
        release: Opened fingers and the way out where the motion ends, or where it began if the
            motion is reversed.
        back: Why the motion is reversed before, "" if it is not.
    """

    T_world_target: SE3
    release: Approach
    back: str

    def __post_init__(self) -> None:
        """Keep copies that nobody changes."""
        freeze(self, poses=("T_world_target",))


def planned_ending(
    motion: MotionPlan,
    angle: float,
    place: tuple[float, float] | None,
    *,
    rests: Rests | None = None,
) -> Ending | Failure:
    """How an object is put down after a motion; or why that fails.

    Args:
        motion: The motion; it may include an overshoot beyond the angle.
        angle: Requested turn, rad.
        place: Where the object is to stand, x and y in m, world; where it was if None.
        rests: As for ``stands``.
    """
    task, axis = motion.grasp.task, motion.path.axis
    if not stands(task, axis, angle, rests=rests):
        return backwards(motion, place, "turned so it does not stand")
    release = find_release(motion)
    if isinstance(release, Approach):
        target = object_at_target(task, axis, angle, place)
        return Ending(T_world_target=target, release=release, back="")
    if np.any(motion.path.shift):
        return backwards(motion, place, f"moved so the hand cannot let go: {release}")
    return release.at("cannot let go at the end")


def backwards(motion: MotionPlan, place: tuple[float, float] | None, why: str) -> Ending:
    """The ending that reverses the motion and puts the object down as it was picked up."""
    grasp, path = motion.grasp, motion.path
    release = Approach(
        q=grasp.q_pregrasp,
        pregrasp_distance=grasp.pregrasp_distance,
        T_world_base_start=grasp.T_world_base_start,
        arm=grasp.arm,
    )
    target = object_at_target(grasp.task, path.axis, 0.0, place)
    return Ending(T_world_target=target, release=release, back=why)


def stands(task: GraspTask, axis: FloatArray, angle: float, *, rests: Rests | None = None) -> bool:
    """Whether an object stands as securely after a turn as before.

    On a table it does after any turn about the vertical, and on another stable face. On obstacles
    that carry it above the table it does if it looks the same from all sides; else ``rests`` tells.

    Args:
        task: Where it stands before.
        axis: Axis of the turn (3,), unit, world.
        angle: The turn, rad.
        rests: Whether an object stays where a task has it. Without it geometry alone decides, and
        an
            object that only a simulation can judge counts as one that falls.
    """
    shape, before = task.object.shape, task.T_world_object.rotation
    turned = pin.exp3(angle * axis) @ before
    carried = bool(task.carrying)  # the obstacles fit the present attitude
    upright = bool(turned[2] @ before[2] > FLAT)
    if upright and not carried:
        return True
    directions = np.random.default_rng(0).normal(size=(DIRECTIONS, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    extents = np.array([[shape.support(d @ r) for d in directions] for r in (before, turned)])
    if np.abs(extents[0] - extents[1]).max() < ALIKE:
        return True
    if carried:
        if not upright or rests is None:
            return False
        return rests(replace(task, T_world_object=object_at_target(task, axis, angle, None)))
    return any(turned[2] @ pose.rotation[2] > FLAT for pose in shape.resting_poses())


def object_at_target(
    task: GraspTask, axis: FloatArray, angle: float, place: tuple[float, float] | None
) -> SE3:
    """Pose of the object turned, at a place, at the height at which it stands there.

    On a table its lowest point is as high as at first; on obstacles above a table it is as high as
    it lies on them.
    """
    first, shape = task.T_world_object, task.object.shape
    turned = pin.exp3(angle * axis) @ first.rotation
    height = task.lowest_point(first) + shape.support(-turned[2])
    pose = SE3(turned, np.array([*first.translation[:2], height]))
    lift = lift_to_rest(shape, pose, task.carrying, -SINKS, SINKS) if task.carrying else 0.0
    x, y = first.translation[:2] if place is None else place
    return SE3(turned, np.array([x, y, height + (lift or 0.0)]))


def standing_under(task: GraspTask, target: SE3) -> tuple[Obstacle, ...]:
    """Copies at the target of the obstacles that carry the object, if that is another place."""
    gone = target.translation - task.T_world_object.translation
    if np.linalg.norm(gone[:2]) < SAME_PLACE:
        return ()
    by = np.array([*gone[:2], 0.0])
    return tuple(replace(o.moved(by), name=f"{o.name} at the target") for o in task.carrying)
