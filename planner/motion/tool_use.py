"""``with_use``: a grasp of a tool and the way of its use, as a movement that was verified.

For ``sim.tools``, whose kinds of uses know the way, and for files (``planner.files.movements``).
"""

from __future__ import annotations

import numpy as np

from planner.collision.pad_contact import pad_contact_queries
from planner.collision.world import CollisionWorld
from planner.errors import TaskError
from planner.failure import Failure
from planner.motion.path import ObjectPath
from planner.motion.phase import ToolUse
from planner.motion.plan import ManipulationPlan
from planner.motion.verify import MovementVerifier
from planner.plan import GraspPlan
from planner.tolerances import JOINT_TOL, PENETRATION_TOL
from planner.tools import Tool, way_blocked


def with_use(grasp: GraspPlan, use: ToolUse) -> ManipulationPlan | Failure:
    """The movement of a tool's use by the hand as a whole; or why it is none.

    The tool stays in the fingers, which produce what it needs (``MovementVerifier``); the base
    keeps its distance from what stands around at every pose of its way; and a finger that works
    leads from the grasp through postures within its limits in which nothing is penetrated. How the
    tool's fixture stands in that finger's way is for the use to say, which knows the fixture.

    Args:
        grasp: A grasp of the tool.
        use: Its way.

    Raises:
        TaskError: The grasp is of no tool, or the use's finger is none of the hand that is free.
    """
    task = grasp.task
    if not isinstance(task.object, Tool):
        raise TaskError(f"{task.object.name} is no tool; give a grasp of one, as plan_use makes")
    failure = way_blocked(grasp, use.way) or _finger_blocked(grasp, use)
    if failure is not None:
        return failure
    held = ObjectPath.of_wrist(np.eye(3))
    knots = MovementVerifier(task).held(grasp.T_world_base, grasp.q, held)
    if isinstance(knots, Failure):
        return knots
    return ManipulationPlan.of_held(grasp, knots, use, tool=task.object)


def _finger_blocked(grasp: GraspPlan, use: ToolUse) -> Failure | None:
    """Why a finger cannot go through its postures; None if it can, or if none works."""
    task, hand = grasp.task, grasp.task.hand
    if not use.finger and (len(use.postures) or len(use.way) < 2):
        text = "without a finger that works a use has a way of two poses or more, and no postures"
        return Failure(kind="use_way", text=text)
    if not use.finger:
        return None
    free = [name for name in hand.fingers if name not in task.finger_names]
    if use.finger not in free:
        raise TaskError(
            f"{use.finger} does not work in a use, as it holds or is none of {hand.name}'s; free "
            f"are {', '.join(free) or 'none'}"
        )
    moved = np.abs(use.postures - grasp.q)
    others = np.setdiff1d(np.arange(hand.nq), hand.fingers[use.finger].q_index)
    if not len(moved) or moved[0].max() > JOINT_TOL or moved[:, others].max() > JOINT_TOL:
        text = f"the way of {use.finger} does not begin at the grasp, or moves other joints too"
        return Failure(kind="use_way", text=text)
    beyond = np.maximum(use.postures - hand.q_upper, hand.q_lower - use.postures).max()
    if beyond > JOINT_TOL:
        return Failure(kind="use_way", text=f"{use.finger} is beyond a limit by {beyond:.3g} rad")
    world, pads = CollisionWorld(task), pad_contact_queries(task).names
    for q in use.postures:
        (near, *_) = world.closest(grasp.T_world_base, q, 1, may_touch=pads)
        if near.distance < -PENETRATION_TOL:
            return Failure(
                kind="use_collision",
                text=f"{use.finger} is not free on its way: {near}",
                numbers={"distance": near.distance},
            )
    return None
