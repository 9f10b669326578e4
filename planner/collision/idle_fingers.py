"""Idle fingers, which take no part in a grasp, keep away from everything else.

Called for the fingers opened before a grasp (``planner.approach.pregrasp``), where joints may be
off, and along a motion (``planner.motion.idle_fingers``).
"""

from __future__ import annotations

import numpy as np

from planner.collision.world import CollisionWorld
from planner.hands.hand import Hand
from planner.spatial import SE3, FloatArray

ROOTS = 2
"""Joints of a finger, from its root, that move it away: abduction and flexion of the knuckle."""

STEP, SWEEPS = float(np.deg2rad(2.0)), 2
"""Change of a joint (rad) that is tried in both directions, and how often all joints are tried."""

NEAR = 0.0015
"""Distance (m) over which nearness falls by a factor e, where joints are where they are read."""

PAIRS = 24
"""Nearest pairs that count."""


def idle_joints(hand: Hand, taking_part: tuple[str, ...]) -> list[int]:
    """The first joints of idle fingers that are not coupled to others."""
    matrix, _ = hand.coupling_matrix
    coupled = (matrix != 0).any(axis=0)
    fingers = [f for name, f in hand.fingers.items() if name not in taking_part]
    return [int(j) for f in fingers for j in f.q_index[:ROOTS] if not coupled[j]]


def spread_idle(
    world: CollisionWorld,
    T_world_base: SE3,
    q: FloatArray,
    *,
    near: float = NEAR,
    sweeps: int = SWEEPS,
) -> FloatArray:
    """Joints (nq,) with idle fingers moved away, as far as that helps; the others stay.

    Args:
        world: Of the task, or without its surroundings.
        T_world_base: Pose of the base.
        q: Joints (nq,) to begin with.
        near: Distance (m) over which nearness falls by a factor e.
        sweeps: How often all joints are tried, by ``STEP`` each time.
    """
    hand, names = world.task.hand, world.task.finger_names
    joints, finger_of = idle_joints(hand, names), hand.finger_of_body
    idle = set(hand.fingers) - set(names)
    geometries = {g.name for g in hand.geometries if finger_of.get(g.body, "") in idle}

    def nearness(q: FloatArray) -> float:
        closest = world.closest(T_world_base, q, PAIRS)
        mine = [c.distance for c in closest if {c.first, c.second} & geometries]
        return float(np.exp(-np.array(mine) / near).sum())

    q = np.clip(q, hand.q_lower, hand.q_upper)
    best = nearness(q)
    for _ in range(sweeps if joints else 0):
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
