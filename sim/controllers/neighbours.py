"""``Neighbours``: how near the links of a finger are to those of the other fingers, by the joints.

Called by ``GuardedClosing`` while a finger looks for the object beyond its planned contact: nothing
was planned there, and on a hand with narrow fingers it would run into its neighbour.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planner.hands.fingers import Finger
from planner.hands.hand import Hand
from planner.kinematics.state import MovingHand
from planner.spatial import FloatArray
from planner.synthesis.link_capsules import closest_on_segments, collision_pairs, finger_capsules


class Neighbours:
    """Distances between fingers, their links taken as capsules."""

    def __init__(self, hand: Hand, fingers: Sequence[Finger]) -> None:
        """Find the pairs of links that can meet.

        Args:
            hand: The hand.
            fingers: The n fingers that are asked for.
        """
        capsules = finger_capsules(hand)
        self._pairs = np.array(collision_pairs(hand), dtype=np.int64).reshape(-1, 2)
        self._joints = [c.joint_id for c in capsules]
        self._ends = np.array([[c.inner, c.outer] for c in capsules]).reshape(-1, 2, 3)
        self._radii = np.array([c.radius for c in capsules])[self._pairs].sum(axis=1)
        names = np.array([c.finger for c in capsules])[self._pairs]
        self._of = [np.flatnonzero((names == finger.name).any(axis=1)) for finger in fingers]
        self._moving = MovingHand(hand, (hand.q_lower + hand.q_upper) / 2.0)

    def gap(self, finger: int, q: FloatArray) -> float:
        """Distance (m) of a finger, by its number, from the nearest other one at joints q (nq,).

        Below 0 where capsules overlap; infinite if it meets no other.
        """
        mine = self._of[finger]
        if not len(mine):
            return np.inf
        poses = self._moving.move(q).pin_data.oMi
        turns = np.array([poses[j].rotation for j in self._joints])
        at = np.array([poses[j].translation for j in self._joints])
        ends = np.einsum("cij,ckj->cki", turns, self._ends) + at[:, None]
        first, second = ends[self._pairs[mine, 0]], ends[self._pairs[mine, 1]]
        one, other = closest_on_segments(first[:, 0], first[:, 1], second[:, 0], second[:, 1])
        return float((np.linalg.norm(other - one, axis=1) - self._radii[mine]).min())
