"""How a hand lets go after a motion: fingers opened where the motion ends, and a way out.

The same as a way into a grasp, backwards, and planned by the same code. When the motion has ended
the table is as far below the object's lowest point as it was at first, and obstacles carry the
object if they did.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from planner.collision import CollisionWorld
from planner.motion.plan import MotionPlan
from planner.synthesis.pregrasp import Approach, find_approach

__all__ = ["find_release"]


def find_release(motion: MotionPlan) -> Approach | str:
    """Opened fingers and a straight way out at the end of a motion; or why there are none.

    The poses are where the grasp is, like those of the motion: put down elsewhere, hand and object
    move together.
    """
    end, task = motion.knots[-1], motion.grasp.task
    table, carrying = task.table_height, task.carrying
    if table is not None:
        first, last = task.T_world_object, end.T_world_object
        risen = task.lowest_point(last) - task.lowest_point(first)
        table += risen
        gone = last.translation - first.translation
        carrying = tuple(o.moved(np.array([*gone[:2], risen])) for o in carrying)
    there = replace(task, T_world_object=end.T_world_object, table_height=table, obstacles=carrying)
    return find_approach(CollisionWorld(there), motion.T_world_base, end.q, end.contacts.normals)
