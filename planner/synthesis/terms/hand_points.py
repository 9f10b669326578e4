"""Derivatives of points that move with the hand, from the Jacobians of its joints.

    point = R0 M(s) b(q) + t,     row = direction . (d point / d unknowns),
    d point / d s_k = R0 M(s) [rates_k x b],   d b / d q_k = v_k + omega_k x b,

with b a point of the base, or of the arm's last link, and rates as in ``mrp_rates``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planner.hands.hand import Hand
from planner.spatial import FloatArray, IntArray
from planner.synthesis.unknowns import Unknowns


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
        moments = _cross(at, along)
        out[:, :3], out[:, 3:6] = moments @ placement.rates, directions
        if placement.root is not None:
            carried = self._carried[which]
            out[:, :6] *= carried
            along = np.where(carried, along, directions @ placement.root)
            moments = _cross(at, along)
        self._unknowns.q(out.T)[:] = self._by_joints(placement.columns, which, along, moments).T
        return out

    def joint_rows(
        self, twists: FloatArray, which: IntArray, at: FloatArray, directions: FloatArray
    ) -> FloatArray:
        """Derivatives (k, nq) by the joints alone, along directions (k, 3) of the base's frame.

        Twists of the joints are (nq, 6), see ``Placement``.
        """
        return self._by_joints(twists, which, directions, _cross(at, directions))

    def _by_joints(
        self, twists: FloatArray, which: IntArray, along: FloatArray, moments: FloatArray
    ) -> FloatArray:
        rates = np.hstack([along, moments]) @ twists.T
        rates *= self._moved[which]
        return rates


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Row by row, (k, 3); numpy's own takes five times as long on short arrays."""
    return a[:, NEXT] * b[:, AFTER] - a[:, AFTER] * b[:, NEXT]


NEXT, AFTER = np.array([1, 2, 0]), np.array([2, 0, 1])
