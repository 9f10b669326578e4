"""``out_of_the_way``: idle fingers keep away from the fingers of a motion.

The planner keeps 2 mm between fingers. A finger that turns an object deviates from its planned
posture by some degrees, more if the object is off its planned place, and would push a neighbour
2 mm away. So idle fingers spread from their planned postures as far as that helps. The planned
motion of the other fingers stays.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from planner.collision.world import CollisionWorld
from planner.hands.hand import Hand
from planner.motion.plan import MovementPlan
from planner.spatial import SE3, FloatArray

ROOTS = 2
"""Joints of a finger, from its root, that move it away: abduction and flexion of the knuckle."""

STEP, SWEEPS = float(np.deg2rad(2.0)), 2
"""Change of a joint (rad) that is tried in both directions, and how often all joints are tried at a
knot: at most 4 degrees from one knot to the next."""

NEAR = 0.0015
"""Distance (m) over which nearness falls by a factor e."""

PAIRS = 24
"""Nearest pairs that count."""


def out_of_the_way(motion: MovementPlan) -> MovementPlan:
    """The motion with idle fingers moved away from everything else.

    The first knot stays: it is the grasp. A hand without idle fingers gets its motion back.
    """
    task = replace(motion.grasp.task, table_height=None, obstacles=())
    joints = _joints(task.hand, task.finger_names)
    if not len(joints):
        return motion
    world, idle = CollisionWorld(task), _idle_geometries(task.hand, task.finger_names)
    offset, knots = np.zeros(task.hand.nq), [motion.knots[0]]
    for knot in motion.knots[1:]:
        T_world_base = task.T_world_object * knot.T_world_object.inverse() * motion.T_world_base
        q = _spread(world, T_world_base, knot.q, offset, joints, idle)
        offset = q - knot.q
        knots.append(replace(knot, q=q))
    return motion.with_knots(knots)


def _joints(hand: Hand, taking_part: tuple[str, ...]) -> list[int]:
    """The first joints of idle fingers that are not coupled to others."""
    matrix, _ = hand.coupling_matrix
    coupled = (matrix != 0).any(axis=0)
    fingers = [f for name, f in hand.fingers.items() if name not in taking_part]
    return [int(j) for f in fingers for j in f.q_index[:ROOTS] if not coupled[j]]


def _idle_geometries(hand: Hand, taking_part: tuple[str, ...]) -> frozenset[str]:
    """Names of the geometries of idle fingers."""
    finger_of = hand.finger_of_body
    names = set(hand.fingers) - set(taking_part)
    return frozenset(g.name for g in hand.geometries if finger_of.get(g.body, "") in names)


def _spread(
    world: CollisionWorld,
    T_world_base: SE3,
    planned: FloatArray,
    offset: FloatArray,
    joints: list[int],
    idle: frozenset[str],
) -> FloatArray:
    """Joints (nq,) at a knot, from the planned ones with the offset of the knot before."""
    hand = world.task.hand

    def nearness(q: FloatArray) -> float:
        near = world.closest(T_world_base, q, PAIRS)
        mine = [c.distance for c in near if c.first in idle or c.second in idle]
        return float(np.exp(-np.array(mine) / NEAR).sum())

    q = np.clip(planned + offset, hand.q_lower, hand.q_upper)
    best = nearness(q)
    for _ in range(SWEEPS):
        before = best
        for joint in joints:
            for step in (STEP, -STEP):
                tried = q.copy()
                tried[joint] = np.clip(q[joint] + step, hand.q_lower[joint], hand.q_upper[joint])
                value = nearness(tried)
                if value < best:
                    q, best = tried, value
                    break
        if best == before:
            break
    return q
