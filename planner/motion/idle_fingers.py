"""``out_of_the_way``: idle fingers keep away from the fingers of a motion.

The planner keeps 2 mm between fingers. A finger that turns an object deviates from its planned
posture by some degrees, more if the object is off its planned place, and would push a neighbour
2 mm away. So idle fingers spread from their planned postures as far as that helps. The planned
motion of the other fingers stays.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from planner.collision.pregrasp_ik import idle_joints, spread_idle
from planner.collision.world import CollisionWorld
from planner.motion.plan import MovementPlan


def out_of_the_way(motion: MovementPlan) -> MovementPlan:
    """The motion with idle fingers moved away from everything else.

    The first knot stays: it is the grasp. From one knot to the next they move by at most two steps
    of a joint, 4 degrees. A hand without idle fingers gets its motion back.
    """
    task = replace(motion.grasp.task, table_height=None, obstacles=())
    if not idle_joints(task.hand, task.finger_names):
        return motion
    world = CollisionWorld(task)
    offset, knots = np.zeros(task.hand.nq), [motion.knots[0]]
    for knot in motion.knots[1:]:
        T_world_base = task.T_world_object * knot.T_world_object.inverse() * motion.T_world_base
        q = spread_idle(world, T_world_base, knot.q + offset)
        offset = q - knot.q
        knots.append(replace(knot, q=q))
    return motion.with_knots(knots)
