"""The release after a motion: fingers opened where the motion ends, and a straight way out.

It is an approach backwards, planned by the same code. When the motion has ended
the table is as far below the object's lowest point as it was at first. Obstacles carry the object
if they did, as high as it lies on them turned as it is then.
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

__all__ = ["SINKS", "find_release", "verify_release"]

SINKS = 0.01
"""How much (m) higher or lower than at first a turned object may lie on what carries it."""


def find_release(motion: MotionPlan) -> Approach | Failure:
    """Opened fingers and a straight way out at the end of a motion; or why there are none.

    The poses are where the grasp is, like those of the motion: put down elsewhere, hand and object
    move together.
    """
    there, end = _standing(motion), motion.knots[-1]
    if isinstance(there, Failure):
        return there
    return find_approach(CollisionWorld(there), motion.T_world_base, end.q, end.contacts.normals)


def verify_release(motion: MotionPlan, release: Approach) -> Failure | None:
    """What is wrong with a way out at the end of a motion, None if nothing is."""
    there, end = _standing(motion), motion.knots[-1]
    if isinstance(there, Failure):
        return there
    return verify_approach(CollisionWorld(there), motion.T_world_base, end.q, release)


def _standing(motion: MotionPlan) -> GraspTask | Failure:
    """The task as it is where the object stands at the end of a motion; or why it stands nowhere.

    The object stays where the motion has it, table and obstacles are below it.
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
