"""How fingers go on beyond their planned contacts, and how near that brings them to one another.

``SearchDirection``: the joint motion by which a finger looks for an object that is not where it was
planned. ``Neighbours``: distances between the links of different fingers, taken as capsules.

Called by ``sim.controllers.closing``, which does it, and by ``planner.search.survival``, which
looks at where it ends.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import null_space

from planner.hands.fingers import Finger
from planner.hands.hand import Hand
from planner.kinematics import HandState, MovingHand
from planner.plan import GraspPlan
from planner.spatial import FloatArray, IntArray
from planner.synthesis.terms.fingers import closest_on_segments, collision_pairs, finger_capsules

SEARCH_DAMPING = 0.05
"""Cost of joint motion in a search, as the lever (m/rad) at which a pad's motion across its normal
costs as much. Without it a curled finger, of which hardly a joint moves the pad along its normal,
swings to the side by 8 degrees and comes no nearer."""

STUCK = 1e-2
"""Least a M^-1 a (-) that is divided by: a pad that no joint moves along its normal stays."""

MOST_AROUND = 3.0
"""Most by which a way past a neighbour may be longer than the straight one, in joint motion (-)."""

EVERY = slice(None)
"""All pairs."""


class Neighbours:
    """Distances between fingers, their links taken as capsules.

    Attributes:
        radii: Of all capsules (c,), m.
    """

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
        self.radii = np.array([c.radius for c in capsules])
        self._room = self.radii[self._pairs].sum(axis=1)
        names = np.array([c.finger for c in capsules])[self._pairs]
        owner = hand.finger_of_body
        whole = [  # a link is as near to its neighbours as its finger
            owner.get(next(iter(finger.bodies)), "") if finger.is_link else finger.name
            for finger in fingers
        ]
        self._of = [np.flatnonzero((names == name).any(axis=1)) for name in whole]
        self._moving = MovingHand(hand, (hand.q_lower + hand.q_upper) / 2.0)

    def gap(self, finger: int, q: FloatArray) -> float:
        """Distance (m) of a finger, by its number, from the nearest other one at joints q (nq,).

        Below 0 where capsules overlap; infinite if it meets no other.
        """
        mine = self._of[finger]
        return float(self.gaps_of(self.ends(q), mine).min()) if len(mine) else np.inf

    def ends(self, q: FloatArray) -> FloatArray:
        """Ends (c, 2, 3), m, of all capsules at joints q (nq,), in the hand's base."""
        poses = self._moving.move(q).pin_data.oMi
        turns = np.array([poses[j].rotation for j in self._joints])
        at = np.array([poses[j].translation for j in self._joints])
        return np.asarray(np.einsum("cij,ckj->cki", turns, self._ends) + at[:, None])

    def gaps_of(self, ends: FloatArray, pairs: IntArray | slice = EVERY) -> FloatArray:
        """Distances (k,), m, of links that can meet, all pairs or some, with ends (c, 2, 3), m."""
        first, second = ends[self._pairs[pairs, 0]], ends[self._pairs[pairs, 1]]
        one, other = closest_on_segments(first[:, 0], first[:, 1], second[:, 0], second[:, 1])
        return np.asarray(np.linalg.norm(other - one, axis=1) - self._room[pairs])


@dataclass(frozen=True, kw_only=True, eq=False)
class SearchDirection:
    """How a finger of k joints moves its pad along the contact normal.

    With a = J^T n, the pad's motion along the normal per joint, and T its motion across it, the
    straight way is the joint motion v with

        minimise v^T M v   subject to   a v = 1,   couplings v = 0,   M = T^T T + SEARCH_DAMPING^2 I

    which is M^-1 a / (a M^-1 a) in a basis of what the couplings let.

    Attributes:
        index: The finger's joints (k,).
        along: a (k,), m/rad.
        straight: v (k,), rad/m.
        free: Basis (k, m) of what couplings let.
        cost: M in that basis (m, m).
    """

    index: IntArray
    along: FloatArray
    straight: FloatArray
    free: FloatArray
    cost: FloatArray

    def around(self, slope: FloatArray) -> FloatArray | None:
        """The way (k,), rad/m, that does not lessen a distance that changes by ``slope`` (k,).

        None where there is none, or it is too long.
        """
        if slope @ self.straight >= 0.0:
            return self.straight
        rows = np.vstack([self.along, slope]) @ self.free
        inverse = np.linalg.solve(self.cost, rows.T)
        gram = rows @ inverse
        if np.linalg.det(gram) <= STUCK * gram[0, 0] * gram[1, 1]:
            return None
        way = self.free @ (inverse @ np.linalg.solve(gram, np.array([1.0, 0.0])))
        if np.linalg.norm(way) > MOST_AROUND * np.linalg.norm(self.straight):
            return None
        return np.asarray(way)


def search_directions(plan: GraspPlan) -> list[SearchDirection]:
    """The directions of a plan's fingers, in their order."""
    state = HandState(plan.task.hand, plan.q)
    inverse = plan.T_world_base.inverse()
    couplings, _ = plan.task.hand.coupling_matrix
    directions = []
    for finger, point, normal in zip(
        plan.task.fingers, plan.contacts.positions, plan.contacts.normals, strict=True
    ):
        k = finger.q_index
        jacobian = state.point_jacobian(finger.pad.joint_id, inverse.act(point))[:3, k]
        inwards = inverse.rotation @ normal
        along = jacobian.T @ inwards
        free = null_space(couplings[:, k]) if len(k) else np.zeros((0, 0))
        across = (jacobian - np.outer(inwards, along)) @ free
        cost = across.T @ across + SEARCH_DAMPING**2 * np.eye(free.shape[1])
        way = np.linalg.solve(cost, free.T @ along)
        straight = free @ way / max(float(along @ free @ way), STUCK)
        directions.append(
            SearchDirection(index=k, along=along, straight=straight, free=free, cost=cost)
        )
    return directions
