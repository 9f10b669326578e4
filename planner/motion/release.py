"""How a hand lets go after a motion: fingers opened where the motion ends, and a way out.

The same as a way into a grasp, backwards, and planned by the same code: the object stands on a
table as high as its lowest point is when the motion has ended.
"""

from __future__ import annotations

from dataclasses import replace

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
    table = task.table_height
    if table is not None:
        pose = end.T_world_object
        support = task.object.shape.support(-pose.rotation[2])
        table = float(pose.translation[2] - support)
    there = replace(task, T_world_object=end.T_world_object, table_height=table, obstacles=())
    return find_approach(CollisionWorld(there), motion.T_world_base, end.q, end.contacts.normals)
