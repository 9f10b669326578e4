"""Derivatives of points that move with the hand, from the Jacobians of its joints.

    point = R0 M(s) b(q) + t,     row = direction . (d point / d unknowns),
    d point / d s_k = R0 M(s) [rates_k x b],   d b / d q_k = v_k + omega_k x b,

with b a point of the base, or of the arm's last link, and rates as in ``mrp_rates``.
``HandPoints`` computes rows in NumPy, ``point_row`` in compiled loops.

The compiled part of a term stands in the term's file, below its part in NumPy, and appends its
rows to ``Rows``. A row has the entries that can differ from zero, and no others: a tenth of all.
numba takes long to compile views and small arrays, so loops read entries of large arrays that are
made beforehand. What a program computes is found at ``*_at`` in its work array.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from planner.hands.hand import Hand
from planner.numerics.kernels import loops_of_kernels
from planner.spatial import FloatArray, IntArray, cross
from planner.synthesis.symbols import GraspSymbols, Unknowns


@dataclass(frozen=True, kw_only=True)
class Placement:
    """Where the hand is.

    Attributes:
        rotation: Transpose (3, 3) of R0 M(s).
        rates: ``mrp_rates`` of s (3, 3).
        columns: Twists (nq, 6) of the joints, see ``SymbolicHand.joint_columns``.
        root: Rotation (3, 3) of an arm's root in the object's frame; None without an arm.
    """

    rotation: FloatArray
    rates: FloatArray
    columns: FloatArray
    root: FloatArray | None


class HandPoints:
    """Points fixed in joints' frames: which unknowns move each."""

    def __init__(self, hand: Hand, unknowns: Unknowns, joints: list[int]) -> None:
        """Look up what moves the points.

        Args:
            hand: The hand.
            unknowns: Layout of the unknowns.
            joints: Pinocchio joint that each point moves with.
        """
        self._unknowns = unknowns
        moved = hand.moved_by[np.array(joints, dtype=np.int64)]
        self._moved = moved.reshape(len(joints), hand.nq).copy()
        # what the arm carries is placed by the unknowns s and t, its other links by its joints
        self._carried = np.ones((len(joints), 1), dtype=bool)
        if hand.arm is not None:
            self._carried = self._moved[:, hand.arm.chain[-1:]].copy()
            self._moved[np.ix_(self._carried[:, 0], hand.arm.chain)] = False

    def rows(
        self, placement: Placement, which: IntArray, at: FloatArray, directions: FloatArray
    ) -> FloatArray:
        """Derivatives (k, n) of points b (k, 3) along directions (k, 3) of the object's frame."""
        along = directions @ placement.rotation
        out = np.zeros((len(which), self._unknowns.size))
        moments = cross(at, along)
        out[:, :3], out[:, 3:6] = moments @ placement.rates, directions
        if placement.root is not None:
            carried = self._carried[which]
            out[:, :6] *= carried
            along = np.where(carried, along, directions @ placement.root)
            moments = cross(at, along)
        self._unknowns.q(out.T)[:] = self._by_joints(placement.columns, which, along, moments).T
        return out

    def joint_rows(
        self, twists: FloatArray, which: IntArray, at: FloatArray, directions: FloatArray
    ) -> FloatArray:
        """Derivatives (k, nq) by the joints alone, along directions (k, 3) of the base's frame.

        Twists of the joints are (nq, 6), see ``Placement``.
        """
        return self._by_joints(twists, which, directions, cross(at, directions))

    def _by_joints(
        self, twists: FloatArray, which: IntArray, along: FloatArray, moments: FloatArray
    ) -> FloatArray:
        rates = np.hstack([along, moments]) @ twists.T
        rates *= self._moved[which]
        return rates


def side_by_side(points: list[Any]) -> Any:
    """Expressions of n points as (3, n); n may be 0."""
    return ca.horzcat(*points) if points else ca.SX(3, 0)


class Rows(NamedTuple):
    """The weighted rows of the last evaluation.

    Attributes:
        values: (r,).
        ends: Where the entries of each row end (r,).
        columns, entries: Unknown and value of each entry.
        least: Least value of each term that must hold and whose rows are numbers; 0 where none is
            violated. Of term ``place``.
        weights: Their weights.
        filled: Rows, and entries, so far (2,).
    """

    values: FloatArray
    ends: IntArray
    columns: IntArray
    entries: FloatArray
    least: FloatArray
    weights: FloatArray
    filled: IntArray


class Joints(NamedTuple):
    """How the hand moves; joint 0 is the base, or an arm's root.

    Attributes:
        twists_at: Of each joint linear and angular rate (6 nq,), in the frame of its placement.
        rotation_at: R0 M(s) by rows (9,).
        joints_at: Of each joint its rotation by rows, then its origin (12 (nq + 1),).
        chains: Joints (places in q) that move what is fixed to each joint, all in one array.
        chain_ends: Those of joint j are from ``chain_ends[j]`` to ``chain_ends[j + 1]`` (nq + 2,).
        carried: Whether s and t move what is fixed to a joint: 1 or 0 (nq + 1,).
    """

    twists_at: IntArray
    rotation_at: IntArray
    joints_at: IntArray
    chains: IntArray
    chain_ends: IntArray
    carried: IntArray


class HandAt(NamedTuple):
    """Where the hand is at the last evaluation, see ``Joints``.

    Attributes:
        joints: (12 (nq + 1),).
        twists: (6 nq,).
        frames: Rotation and origin of an arm's root, then of what s and t move, (2, 12); m.
        rates: ``mrp_rates`` of s (3, 3).
    """

    joints: FloatArray
    twists: FloatArray
    frames: FloatArray
    rates: FloatArray


def joint_outputs(g: GraspSymbols) -> list[ca.SX]:
    """Expressions of ``Joints``: twists (6, nq), rotation (3, 3), frames (12, nq + 1)."""
    frames = [g.symbolic.joint(j) for j in range(g.hand.nq + 1)]
    placed = [ca.vertcat(ca.vec(r.T), t) for r, t in frames]
    return [g.symbolic.joint_columns(), g.rotation.T, ca.horzcat(*placed)]


def joints_of(hand: Hand, twists: IntArray, rotation: IntArray, frames: IntArray) -> Joints:
    """What moves what, with the places of ``joint_outputs``.

    What the arm carries is placed by the unknowns s and t, its other links by its joints.
    """
    moved = hand.moved_by.copy()
    carried = np.ones(len(moved), dtype=bool)
    if hand.arm is not None:
        carried = moved[:, hand.arm.chain[-1]].copy()
        moved[np.ix_(carried, hand.arm.chain)] = False
    return Joints(
        twists_at=twists,
        rotation_at=rotation,
        joints_at=frames,
        chains=np.nonzero(moved)[1],
        chain_ends=np.append(0, np.cumsum(moved.sum(axis=1))),
        carried=carried.astype(np.int64),
    )


def hand_at(joints: Joints, root: FloatArray) -> HandAt:
    """Places for where the hand is; an arm has a root (12,), its rotation by columns."""
    frames = np.zeros((2, 12))
    if len(root):
        frames[0, :9], frames[0, 9:] = root[:9].reshape(3, 3).T.ravel(), root[9:]
    return HandAt(
        joints=np.zeros(len(joints.joints_at)),
        twists=np.zeros(len(joints.twists_at)),
        frames=frames,
        rates=np.zeros((3, 3)),
    )


@loops_of_kernels
def place_hand(p: Joints, hand: HandAt, work: FloatArray, x: FloatArray) -> None:
    """Write where the hand is at unknowns x (n,), for which the work array is computed."""
    for k in range(len(hand.joints)):
        hand.joints[k] = work[p.joints_at[k]]
    for k in range(len(hand.twists)):
        hand.twists[k] = work[p.twists_at[k]]
    for k in range(9):
        hand.frames[1, k] = work[p.rotation_at[k]]
    for k in range(3):
        hand.frames[1, 9 + k] = x[3 + k]
    out = hand.rates
    a, b, c = x[0], x[1], x[2]
    n = a * a + b * b + c * c
    d, k4 = 1 - n, 4 / (1 + n) ** 2
    out[0, 0], out[0, 1] = k4 * (d + 2 * a * a), k4 * (2 * (a * b + c))
    out[0, 2], out[1, 0] = k4 * (2 * (a * c - b)), k4 * (2 * (a * b - c))
    out[1, 1], out[1, 2] = k4 * (d + 2 * b * b), k4 * (2 * (b * c + a))
    out[2, 0], out[2, 1] = k4 * (2 * (a * c + b)), k4 * (2 * (b * c - a))
    out[2, 2] = k4 * (d + 2 * c * c)


@loops_of_kernels
def move(hand: HandAt, joint: int, points: FloatArray, k: int, out: FloatArray) -> None:
    """Point k (3,) of points fixed to a joint, in the frame of base, flange or root."""
    o, r = 12 * joint, hand.joints
    for i in range(3):
        at = o + 3 * i
        out[k, i] = (
            r[at] * points[k, 0]
            + r[at + 1] * points[k, 1]
            + r[at + 2] * points[k, 2]
            + r[o + 9 + i]
        )


@loops_of_kernels
def point_row(
    p: Joints,
    hand: HandAt,
    rows: Rows,
    place: int,
    joint: int,
    local: FloatArray,
    k: int,
    gap: float,
    slopes: FloatArray,
    s: int,
) -> None:
    """Append the gap of point k (3,) that moves with a joint, with slope s (3,)."""
    weight, at, f = rows.weights[place], rows.filled[1], p.carried[joint]
    rows.least[place] = min(rows.least[place], gap)
    d0, d1, d2 = slopes[s, 0], slopes[s, 1], slopes[s, 2]
    b0, b1, b2 = local[k, 0], local[k, 1], local[k, 2]
    turn, columns, entries = hand.frames, rows.columns, rows.entries
    a0 = d0 * turn[f, 0] + d1 * turn[f, 3] + d2 * turn[f, 6]
    a1 = d0 * turn[f, 1] + d1 * turn[f, 4] + d2 * turn[f, 7]
    a2 = d0 * turn[f, 2] + d1 * turn[f, 5] + d2 * turn[f, 8]
    m0, m1, m2 = b1 * a2 - b2 * a1, b2 * a0 - b0 * a2, b0 * a1 - b1 * a0
    if f == 1:
        rates = hand.rates
        for i in range(3):
            columns[at + i], columns[at + 3 + i] = i, 3 + i
            entries[at + i] = weight * (m0 * rates[0, i] + m1 * rates[1, i] + m2 * rates[2, i])
            entries[at + 3 + i] = weight * slopes[s, i]
        at += 6
    twists = hand.twists
    for c in range(p.chain_ends[joint], p.chain_ends[joint + 1]):
        j = p.chains[c]
        t = 6 * j
        rate = twists[t] * a0 + twists[t + 1] * a1 + twists[t + 2] * a2
        rate += twists[t + 3] * m0 + twists[t + 4] * m1 + twists[t + 5] * m2
        columns[at], entries[at] = 6 + j, weight * rate
        at += 1
    end_row(rows, weight * gap, at)


@loops_of_kernels
def end_row(rows: Rows, value: float, end: int) -> None:
    """Finish a row whose entries have been appended: its weighted value, where they end."""
    n = rows.filled[0]
    rows.values[n], rows.ends[n] = value, end
    rows.filled[0], rows.filled[1] = n + 1, end
