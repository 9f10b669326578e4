"""The release after a motion: fingers opened where the motion ends, and a straight way out.

It is an approach in reverse, planned by the same code. At the end of the motion the table is as far
below the object's lowest point as at the start. Obstacles that carried the object carry it again,
at the height at which the turned object lies on them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from planner.approach.pregrasp import Approach, find_approach, verify_approach
from planner.collision.resting import lift_to_rest
from planner.collision.world import CollisionWorld
from planner.failure import Failure
from planner.motion.plan import MotionPlan
from planner.task import GraspTask

SINKS = 0.01
"""Largest change of height (m) of a turned object on the obstacles that carry it."""


def find_release(motion: MotionPlan) -> Approach | Failure:
    """Opened fingers and a straight way out at the end of a motion; or why there are none.

    Poses are relative to the grasp, like those of the motion: put down elsewhere, hand and object
    move together.
    """
    there, end = standing(motion), motion.knots[-1]
    if isinstance(there, Failure):
        return there
    return find_approach(CollisionWorld(there), motion.T_world_base, end.q, end.contacts.normals)


def verify_release(motion: MotionPlan, release: Approach) -> Failure | None:
    """Why a way out at the end of a motion fails, None if it is free."""
    there, end = standing(motion), motion.knots[-1]
    if isinstance(there, Failure):
        return there
    return verify_approach(CollisionWorld(there), motion.T_world_base, end.q, release)


def standing(motion: MotionPlan) -> GraspTask | Failure:
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
