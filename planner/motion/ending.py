"""``Ending``: how an object that was turned or moved in the hand is put down.

The object is put down in its final attitude if it stands in it: after a turn about the vertical, a
turn onto its own symmetry, or a turn onto another stable face. The hand must also find a way out
there. Otherwise the motion is reversed first, and the object is put down as it was picked up.

The release after a motion: fingers opened where the motion ends, and a straight way out.

It is an approach in reverse, planned by the same code. At the end of the motion the table is as far
below the object's lowest point as at the start. Obstacles that carried the object carry it again,
at the height at which the turned object lies on them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TypeAlias

import numpy as np
import pinocchio as pin

from planner.collision.pair_table import lift_to_rest
from planner.collision.pregrasp import Approach, find_approach, verify_approach
from planner.collision.world import CollisionWorld
from planner.failure import Failure
from planner.motion.phase import Ending
from planner.motion.plan import MovementPlan
from planner.spatial import SE3, FloatArray, rotation_angle
from planner.task import GraspTask

Rests: TypeAlias = Callable[[GraspTask], bool]
"""Whether the object of a task stays where the task has it; ``sim.manipulation.rests`` is one."""

FLAT = np.cos(np.deg2rad(0.5))
"""Least cosine (-) between two directions that count as equal."""

ALIKE = 1e-4
"""Largest difference (m) of a solid's extents in two attitudes that count as equal."""

DIRECTIONS = 200
"""Number of directions in which the extents are compared."""


def planned_ending(
    motion: MovementPlan,
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


def backwards(motion: MovementPlan, place: tuple[float, float] | None, why: str) -> Ending:
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


SINKS = 0.01
"""Largest change of height (m) of a turned object on the obstacles that carry it."""


def find_release(motion: MovementPlan) -> Approach | Failure:
    """Opened fingers and a straight way out at the end of a motion; or why there are none.

    Poses are relative to the grasp, like those of the motion: put down elsewhere, hand and object
    move together.
    """
    there, end = standing(motion), motion.knots[-1]
    if isinstance(there, Failure):
        return there
    return find_approach(CollisionWorld(there), motion.T_world_base, end.q, end.contacts.normals)


def let_go(motion: MovementPlan, angle: float) -> Ending | Failure:
    """The ending of an object that is let go where it is, turned by an angle (rad); or why not."""
    release = find_release(motion)
    if isinstance(release, Failure):
        return release
    target = object_at_target(motion.grasp.task, motion.path.axis, angle, None)
    return Ending(T_world_target=target, release=release, back="")


def verify_release(motion: MovementPlan, release: Approach) -> Failure | None:
    """Why a way out at the end of a motion fails, None if it is free."""
    there, end = standing(motion), motion.knots[-1]
    if isinstance(there, Failure):
        return there
    return verify_approach(CollisionWorld(there), motion.T_world_base, end.q, release)


def turned_ending(motion: MovementPlan, T_world_target: SE3, release: Approach | None) -> Ending:
    """The ending of a hand that stays in the attitude of the path, which puts down or holds.

    Args:
        motion: The motion.
        T_world_target: Final pose of the object, as it is turned in the attitude.
        release: Opened fingers and the way out there, world; None if it is held.
    """
    if release is not None:
        back = hand_at_target(motion, T_world_target) * motion.T_world_base.inverse()
        start = back.inverse() * release.T_world_base_start
        release = replace(release, T_world_base_start=start)
    return Ending(T_world_target=T_world_target, release=release, back="", turned=True)


def hand_at_target(motion: MovementPlan, T_world_target: SE3) -> SE3:
    """Pose of the base when the object, as it lies in the hand at the end, is at a pose."""
    return T_world_target * motion.knots[-1].T_world_object.inverse() * motion.T_world_base


def verify_turned(motion: MovementPlan, ending: Ending) -> Failure | None:
    """Why a hand cannot end in the attitude of the path as an ending says, None if it can."""
    task, target, end = motion.grasp.task, ending.T_world_target, motion.knots[-1]
    turned = motion.path.attitude @ end.T_world_object.rotation
    if rotation_angle(turned.T @ target.rotation) > SAME_TURN:
        return Failure(kind="falls", text="the object is not turned to its target")
    if ending.release is None:
        if abs(target.translation[2] - task.T_world_object.translation[2]) > ALIKE:
            return Failure(kind="falls", text="it is held at another height than it was grasped at")
        return None
    table, shape = task.table_height, task.object.shape
    down = target.rotation[2]
    flat = any(down @ pose.rotation[2] > FLAT for pose in shape.resting_poses())
    lowest = target.translation[2] - shape.support(-down)
    if table is None or not flat or abs(lowest - table) > ALIKE:
        return Failure(kind="falls", text="the object does not stand on the table at its target")
    base = hand_at_target(motion, target)
    back = base * motion.T_world_base.inverse()
    out = replace(ending.release, T_world_base_start=back * ending.release.T_world_base_start)
    there = CollisionWorld(replace(task, T_world_object=target))
    return verify_approach(there, base, end.q, out)


SAME_TURN = 1e-6
"""Largest difference (rad) of an object's rotation from that of its target: rounding."""


def standing(motion: MovementPlan) -> GraspTask | Failure:
    """The task with table and obstacles below the object at the end of a motion; or why not.

    The object stays where the motion has it.
    """
    end, task = motion.knots[-1], motion.grasp.task
    table, carrying = task.table_height, task.carrying
    if table is not None:
        first, last = task.T_world_object, end.T_world_object
        risen = task.lowest_point(last) - task.lowest_point(first)
        table += risen
        gone = last.translation - first.translation
        carrying = tuple(o.moved(np.array([*gone[:2], risen])) for o in carrying)
        if carrying:
            shape = task.object.shape
            lift = lift_to_rest(shape, end.T_world_object, carrying, -SINKS, SINKS)
            if lift is None:
                return Failure(
                    kind="no_rest",
                    text=f"turned like that the object does not lie on {carrying[0].name!r} and "
                    f"the others that carried it: it is in them even {1e3 * SINKS:.0f} mm higher",
                )
            carrying = tuple(o.moved(np.array([0.0, 0.0, -lift])) for o in carrying)
            table -= lift
    return replace(task, T_world_object=end.T_world_object, table_height=table, obstacles=carrying)
