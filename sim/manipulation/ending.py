"""``Ending``: how an object that was turned or moved in the hand is put down.

It can be put down as it lies in the hand in the end where it stands so: turned about the vertical,
looking as it did at first, or on another face that it is stable on. Then the hand must get away
from it there. Where one or the other is not the case, the motion is made backwards before, and the
object is put down as it was picked up.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from planner.approach.pregrasp import Approach
from planner.collision.resting import lift_to_rest
from planner.failure import Failure
from planner.motion import MotionPlan
from planner.motion.release import SINKS, find_release
from planner.spatial import SE3, FloatArray
from planner.task import GraspTask, Obstacle
from sim.manipulation.standing import rests

__all__ = ["Ending", "object_at_target", "planned_ending", "standing_under", "stands", "way_back"]

FLAT = np.cos(np.deg2rad(0.5))
"""Least cosine (-) between two directions that are the same."""

ALIKE = 1e-4
"""Difference (m) of a solid's extents in two attitudes that is none."""

DIRECTIONS = 200
"""Directions in which the extents are compared."""

SAME_PLACE = 1e-6
"""Distance (m) between two places that is none."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Ending:
    """How an object is put down.

    Attributes:
        T_world_target: Where it is to stand at last.
        release: Fingers opened, and the way out, where the motion ends; where it began, if it is
            made backwards.
        back: Why the motion is made backwards before, "" if it is not.
    """

    T_world_target: SE3
    release: Approach
    back: str


def planned_ending(
    motion: MotionPlan, angle: float, place: tuple[float, float] | None
) -> Ending | Failure:
    """How an object is put down after a motion; or why it cannot be.

    Args:
        motion: What was planned; it may go a little beyond the angle.
        angle: Turn that is asked for, rad.
        place: Where the object is to stand, x and y in m, world; where it was if None.
    """
    task, axis = motion.grasp.task, motion.path.axis
    if not stands(task, axis, angle):
        return way_back(motion, place, "turned so it does not stand")
    release = find_release(motion)
    if not isinstance(release, Failure):
        target = object_at_target(task, axis, angle, place)
        return Ending(T_world_target=target, release=release, back="")
    if np.any(motion.path.shift):
        return way_back(motion, place, f"moved so the hand cannot let go: {release}")
    return release.at("cannot let go at the end")


def way_back(motion: MotionPlan, place: tuple[float, float] | None, why: str) -> Ending:
    """The object as it was picked up, let go like that."""
    grasp, path = motion.grasp, motion.path
    release = Approach(
        q=grasp.q_pregrasp, opening=grasp.opening, T_world_base_start=grasp.T_world_base_start
    )
    target = object_at_target(grasp.task, path.axis, 0.0, place)
    return Ending(T_world_target=target, release=release, back=why)


def stands(task: GraspTask, axis: FloatArray, angle: float) -> bool:
    """Whether an object stands as securely after a turn as before.

    On a table it does after any turn about the vertical, or on another stable face. On what carries
    it above the table it does where it looks the same from all sides; else the simulation tells.

    Args:
        task: Where it stands before.
        axis: Axis of the turn (3,), unit, world.
        angle: The turn, rad.
    """
    shape, before = task.object.shape, task.T_world_object.rotation
    turned = pin.exp3(angle * axis) @ before
    carried = bool(task.carrying)  # what carries it was made for the attitude that it has
    upright = bool(turned[2] @ before[2] > FLAT)
    if upright and not carried:
        return True
    directions = np.random.default_rng(0).normal(size=(DIRECTIONS, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    extents = np.array([[shape.support(d @ r) for d in directions] for r in (before, turned)])
    if np.abs(extents[0] - extents[1]).max() < ALIKE:
        return True
    if carried:
        return upright and _rests_turned(task, axis, angle)
    return any(turned[2] @ pose.rotation[2] > FLAT for pose in shape.resting_poses())


def object_at_target(
    task: GraspTask, axis: FloatArray, angle: float, place: tuple[float, float] | None
) -> SE3:
    """The object turned, at a place, as high as it stands there like that.

    On a table that is with its lowest point as high as at first; on what carries it above a table
    as high as it lies on that.
    """
    first, shape = task.T_world_object, task.object.shape
    turned = pin.exp3(angle * axis) @ first.rotation
    height = task.lowest_point(first) + shape.support(-turned[2])
    pose = SE3(turned, np.array([*first.translation[:2], height]))
    lift = lift_to_rest(shape, pose, task.carrying, -SINKS, SINKS) if task.carrying else 0.0
    x, y = first.translation[:2] if place is None else place
    return SE3(turned, np.array([x, y, height + (lift or 0.0)]))


def _rests_turned(task: GraspTask, axis: FloatArray, angle: float) -> bool:
    """Whether an object that is turned about the vertical rests on what carries it."""
    turned = object_at_target(task, axis, angle, None)
    return rests(replace(task, T_world_object=turned))


def standing_under(task: GraspTask, target: SE3) -> tuple[Obstacle, ...]:
    """What carries the object at its target as at first, if that is another place."""
    gone = target.translation - task.T_world_object.translation
    if np.linalg.norm(gone[:2]) < SAME_PLACE:
        return ()
    by = np.array([*gone[:2], 0.0])
    return tuple(replace(o.moved(by), name=f"{o.name} at the target") for o in task.carrying)
