"""What true links lack of their distances, linear in the unknowns from where it was looked at.

Balls and bones stand for links in the terms; bars and hulls are wider than those in places. What
coal finds too near at the end of a descent is kept apart by the next one:

    d = n . (b - a),   d' = n . (b' - a'),   p' = R (omega x p + v(q')) + t',

nearest points a and b, and the normal n from a to b. Between fingers the base drops out; what
stands still does not move (``planner.synthesis.avoid`` has the same rates).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planner.collision.pad_contact import pad_contact_queries
from planner.collision.world import CollisionWorld
from planner.spatial import SE3, FloatArray
from planner.synthesis.options import SynthesisOptions
from planner.synthesis.unknowns import Unknowns, mrp_rates

__all__ = ["Gaps", "find_gaps"]

ROOM = 0.0015
"""Distance (m) that is asked of true links from object, table and obstacles, where no pad is."""

AHEAD = 0.0015
"""What lacks less than this (m) of being too near is kept in view: the next steps may close it."""


@dataclass(frozen=True, kw_only=True)
class Gaps:
    """Distances that are too small, or nearly.

    Attributes:
        x: Unknowns (n,) at which they were looked at.
        values: Distance less what is asked there, (k,), m.
        rows: Their derivatives by the unknowns (k, n).
        urgent: Whether any distance is less than half of what is asked.
    """

    x: FloatArray
    values: FloatArray
    rows: FloatArray
    urgent: bool


def find_gaps(
    world: CollisionWorld,
    unknowns: Unknowns,
    x: FloatArray,
    T_object_base: SE3,
    options: SynthesisOptions,
) -> Gaps | None:
    """What is too near, or nearly, at the unknowns x (n,); None if nothing is.

    On an arm only fingers are looked at: the base there is not what s and t place. Distances from a
    mesh are left out: to look at them takes as long as they save attempts (1.3 a grasp so 1.5).

    Args:
        world: True geometry of the task.
        unknowns: Layout of x.
        x: Where to look.
        T_object_base: Pose of the hand's base there.
        options: Distances asked between fingers, and of links that carry pads.
    """
    task, q = world.task, unknowns.q(x)
    hand = task.hand
    farthest = max(ROOM, options.clear_tip, options.clear_fingers) + AHEAD
    near = world.near(
        task.T_world_object * T_object_base,
        q,
        farthest,
        may_touch=pad_contact_queries(task).names,
        meshes=False,
    )
    pads = np.isin(near.joints[:, 0], [f.pad.joint_id for f in task.fingers])
    outward = np.where(pads, options.clear_tip, ROOM)
    asked = np.where(near.hand_environment, outward, options.clear_fingers)
    values = near.distances - asked
    short = values < AHEAD
    if hand.arm is not None:
        short &= ~near.hand_environment
    if not short.any():
        return None
    joints, normals = near.joints[short], near.normals[short]
    points, out = near.points_a[short], near.hand_environment[short][:, None]
    state = world.moving.move(q)
    rows = np.zeros((len(joints), unknowns.size))
    unknowns.q(rows.T)[:] = (
        state.point_rates(joints[:, 1], near.points_b[short], normals)
        - state.point_rates(joints[:, 0], points, normals)
    ).T
    rows[:, :3] = np.where(out, -np.cross(points, normals) @ mrp_rates(x[:3]), 0.0)
    rows[:, 3:6] = np.where(out, -normals @ T_object_base.rotation.T, 0.0)
    urgent = bool((values[short] < -asked[short] / 2).any())
    return Gaps(x=x.copy(), values=values[short], rows=rows, urgent=urgent)
