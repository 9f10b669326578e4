"""Inverse kinematics of the pre-grasp: the fingers of a grasp opened along the contact normals.

    min  sum |c_i(q) - (c_i - distance n_i)|^2 / distance^2 + POSTURE_WEIGHT |q - q_grasp|^2
    s.t. every pad opened by OPENED_SHARE of the distance at least; couplings; joint limits;
         hand clear of object, table, obstacles and of itself

with c_i the pad centres of the grasp and n_i the normals into the object. Gauss-Newton steps, each
a quadratic programme over the joints with everything linearised
(``planner.numerics.least_squares``).
Near pairs enter only if the solution without them comes too near to something. Fingers that stand
close to each other may have to move sideways as well while they open. Violated bounds are
minimised; the verdict is ``planner.collision.pregrasp``'s, on the true geometry.

Idle fingers, which take no part in a grasp, are spread away from everything else where joints may
be off (``spread_idle``), before a grasp and along a motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from planner.collision.world import CollisionWorld, NearPairs
from planner.hands.fingers import Finger
from planner.hands.hand import Hand
from planner.kinematics import point_jacobians, tip_reach
from planner.numerics.least_squares import Barrier, Task, constrained_ik_step
from planner.spatial import SE3, FloatArray, IntArray

__all__ = ["OPENED_SHARE", "PregraspIk", "undetermined_joints"]


OPENED_SHARE = 0.7
"""Share of the pre-grasp distance that every pad must really reach within its joint limits (-)."""

POSTURE_WEIGHT = 0.05
"""Cost of moving a joint by one radian against missing all of the distance (-)."""

OPEN_CLEARANCE = 0.003
"""Distance (m) that the opened hand keeps from object, table and obstacles, where it can; more by a
standard deviation of a pad's place where joints may be off."""

FINGER_CLEARANCE = 0.002
"""Distance (m) that it keeps from itself, where it can."""

MARGIN = 0.002
"""Margin (-) by which bounds are tightened, in pre-grasp distances: the last step leaves less."""

SEEN = 0.03
"""Distance (m) up to which pairs are looked at once one of them is too near."""

PRICE = 100.0
"""Price of missing a bound by one pre-grasp distance (-): more than any task is worth."""

STEPS = (3, 6)
"""Most steps without and with a look at what is near; three to six are usual in all."""

SMALL = 0.02
"""Step (rad) from which on nothing changes that matters: what is linear is right to 20 um then."""

SETTLED = 0.1
"""Last step (rad) after which the fingers stay where all bounds hold: 4 mm at a pad."""

DAMPING = 0.2
"""Cost of a step of one radian (-): joints that pads hardly feel go too far otherwise."""

STILL = 1e-3
"""Rate of a distance (m/rad) below which nothing can be done about it."""

LARGEST = 0.4
"""Longest step of a joint (rad), since pads move on arcs. A joint that turns back may go ``BACK``
of its last step only: a Gauss-Newton step goes too far where the pads stay away from their goals.
"""

BACK = 0.4

UNDETERMINED = 1e-6
"""Share of a joint's motion (-) above which it is no rounding."""

LEAST = 2e-3
"""Shortest step (rad) that a joint is left: the programmes want some room."""


@lru_cache(maxsize=16)
def undetermined_joints(hand: Hand) -> IntArray:
    """Joints (k,) that do not come back in the air the way that they were opened, ascending.

    Found once for a hand; read-only.

    Those of an actuator that moves several joints and leaves it to a contact to hold one of them at
    a stop. In the air the joints share its motion by their damping: if that takes the one off its
    stop, the finger closes into another posture than the grasp's.
    """
    firm = np.vstack([hand.actuation.moment, *(c.row for c in hand.couplings if not c.one_sided)])
    left = np.eye(hand.nq) - np.linalg.pinv(firm) @ firm
    damping = np.array(hand.pin_model.damping)
    yielding = 1.0 / damping if (damping > 0.0).all() else np.ones(hand.nq)
    shared = hand.actuation.moment * yielding / yielding.max()  # (nu, nq), what actuators move
    out = np.zeros(hand.nq, dtype=bool)
    for stop in hand.couplings:
        if stop.one_sided and np.abs(left @ stop.row).max() > UNDETERMINED:
            leaving = np.abs(shared @ stop.row) > UNDETERMINED
            out |= (hand.actuation.moment[leaving] != 0.0).any(axis=0)
    found = np.flatnonzero(out)
    found.flags.writeable = False
    return found


class PregraspIk:
    """Opens the fingers of one grasp, by one distance after the other."""

    def __init__(
        self,
        world: CollisionWorld,
        T_world_base: SE3,
        q: FloatArray,
        normals: FloatArray,
        still: Sequence[int] | IntArray = (),
        fingers: Sequence[Finger] | None = None,
    ) -> None:
        """Compute what does not depend on the distance.

        Args:
            world: True geometry of the task.
            T_world_base: Base pose of the grasp.
            q: Joints of the grasp (nq,).
            normals: Contact normals into the object (n, 3), world, or others to open against.
            still: Joints that stay where the grasp has them.
            fingers: The n fingers or links that are opened; those of the task if None.
        """
        hand, self._fingers = world.task.hand, fingers or world.task.fingers
        self._world, self._T_world_base, self._grasp = world, T_world_base, q
        self._state = world.moving.move(q)
        self._pad_joints, self._begin = self._state.pads(self._fingers)
        self._inward = normals @ T_world_base.rotation  # (n, 3), base
        self._matrix, self._value = hand.coupling_matrix
        self._lower, self._upper = hand.q_lower, hand.q_upper
        moved = np.ones(hand.nq, dtype=bool)
        for held in (hand.wrist_index, hand.arm_index, np.array(still, dtype=np.int64)):
            moved[held] = False
        moved[hand.carriage_index] = True  # an arm of two opens with its palm
        self._free = np.flatnonzero(moved)
        self._held = self._matrix[:, self._free]
        self._clear = OPEN_CLEARANCE + world.task.joint_error * tip_reach(hand)

    def solve(self, distance: float) -> FloatArray | None:
        """Joints (nq,) with the pads back along the normals (m); None if limits forbid it.

        They may touch something there: see ``planner.collision.pregrasp.verify_approach``.
        """
        q = self._descend(self._grasp, distance, None)
        if q is not None:
            clear = {"environment": self._clear, "fingers": FINGER_CLEARANCE}
            if not self._world.is_clear(self._T_world_base, q, **clear):
                near = self._world.near(self._T_world_base, q, SEEN)
                q = self._descend(q, distance, near)
        if q is None or self._shares(q, distance).min() < OPENED_SHARE:
            return None
        return q

    def _descend(self, q: FloatArray, distance: float, near: NearPairs | None) -> FloatArray | None:
        """Joints (nq,) after steps from q, clear of what was near there; None if limits forbid."""
        last, reach = np.zeros(len(q)), np.full(len(q), LARGEST)
        seen = None if near is None else near.numbers[~near.mesh]
        for _ in range(STEPS[near is not None]):
            rows, misses, rates, shares = self._pads(q, distance)
            least = OPENED_SHARE + MARGIN - shares
            if near is not None:
                short, moving = self._near(q, near)
                rates = np.vstack([rates, moving / distance])
                least = np.concatenate([least, short / distance + MARGIN])
                if (least <= MARGIN).all() and np.abs(last).max() < SETTLED:
                    break
            step = self._step(q, rows, misses, rates, least, reach)
            if step is None:
                return None
            q = q + step
            if np.abs(step).max() < SMALL:
                break
            back = np.maximum(BACK * np.abs(last), LEAST)
            reach = np.where(step * last < 0.0, back, reach)
            last = step
            if near is not None:
                near = self._world.near(self._T_world_base, q, SEEN, seen)
        return np.clip(q, self._lower, self._upper)

    def _pads(
        self, q: FloatArray, distance: float
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """See ``_opening``, at q (nq,)."""
        state = self._state.move(q)
        joints, centers = state.pads(self._fingers)
        return _opening(
            state.pin_data.J,
            state.hand.moved_by,
            joints,
            centers,
            self._begin,
            self._inward,
            distance,
        )

    def _shares(self, q: FloatArray, distance: float) -> FloatArray:
        """By which share (n,) of the distance each pad is opened at q (nq,)."""
        moved = self._state.move(q).pads(self._fingers)[1] - self._begin
        return np.asarray(-(moved * self._inward).sum(axis=1) / distance)

    def _near(self, q: FloatArray, near: NearPairs) -> tuple[FloatArray, FloatArray]:
        """By how much distances that can be changed are too small (k,), m, and rates (k, nq)."""
        rates = near.rates(self._state)
        short = np.where(near.hand_environment, self._clear, FINGER_CLEARANCE) - near.distances
        moving = np.abs(rates[:, self._free]).max(axis=1, initial=0.0) > STILL
        return short[moving], rates[moving]

    def _step(
        self,
        q: FloatArray,
        rows: FloatArray,
        misses: FloatArray,
        rates: FloatArray,
        least: FloatArray,
        reach: FloatArray,
    ) -> FloatArray | None:
        """The step (nq,) with least misses + rows @ step where rates @ step >= least.

        None where limits and couplings contradict each other.
        """
        free, n = self._free, len(self._fingers)
        off = self._value - self._matrix @ q
        found = constrained_ik_step(
            Task(rows[:, free], -misses),
            [Barrier(rates[:n, free], least[:n]), Barrier(rates[n:, free], least[n:])],
            np.minimum(np.maximum(self._lower - q, -reach), 0.0)[free],
            np.maximum(np.minimum(self._upper - q, reach), 0.0)[free],
            equality=Task(self._held, off),
            posture=(self._grasp - q)[free],
            posture_weight=POSTURE_WEIGHT,
            damping=DAMPING,
            price=PRICE,
        )
        if found is None:
            return None
        step = np.zeros(len(q))
        step[free] = found
        return step


def _opening(
    jacobian: FloatArray,
    moved_by: NDArray[np.bool_],
    joint_ids: IntArray,
    centers: FloatArray,
    begin: FloatArray,
    inward: FloatArray,
    distance: float,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Where pads are on their way out, in units of a distance, and how that changes.

    Args:
        jacobian: See ``planner.kinematics``.
        moved_by: Likewise.
        joint_ids: Pinocchio joints (n,) that the pads move with.
        centers: Of the pads (n, 3), m, base.
        begin: Where they are at the grasp.
        inward: Normals into the object (n, 3).
        distance: m.

    Returns:
        Rates (3 n, nq) of the misses, misses (3 n,), rates (n, nq) of the shares, shares (n,).
    """
    n = len(centers)
    rows = point_jacobians(jacobian, moved_by, joint_ids, centers)[:, :3] / distance
    moved = (centers - begin) / distance
    rates = -np.einsum("ni,nij->nj", inward, rows)
    shares = -np.einsum("ij,ij->i", moved, inward)
    return rows.reshape(3 * n, -1), (moved + inward).ravel(), rates, shares


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
