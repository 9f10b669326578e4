"""``TipKinematics``: fingertips at joints, and how their velocities change with the joints.

Jacobians are of points that are fixed in the frames of the pads' joints, over the joints that move
any of the fingers that take part.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planner.hands.fingers import Finger
from planner.hands.hand import Hand
from planner.kinematics.state import MovingHand
from planner.spatial import FloatArray, IntArray, cross


@dataclass(frozen=True, slots=True, eq=False)
class Tips:
    """Frames of n pads' joints in the hand's base, and what the joints do to them.

    Attributes:
        rotations: (n, 3, 3).
        origins: (n, 3), m.
        linear: (n, m, 3), velocity of the point at the base's origin per joint rate.
        angular: (n, m, 3), angular velocity per joint rate.
    """

    rotations: FloatArray
    origins: FloatArray
    linear: FloatArray
    angular: FloatArray

    def of(self, fingers: IntArray) -> Tips:
        """Those of some of the fingers only."""
        return Tips(*(getattr(self, name)[fingers] for name in self.__slots__))

    def out(self, local: FloatArray) -> FloatArray:
        """Points (n, 3) of the pads' frames in the base."""
        return np.asarray((self.rotations @ local[:, :, None])[:, :, 0] + self.origins)

    def turned(self, local: FloatArray) -> FloatArray:
        """Vectors (n, 3) of the pads' frames in the base's axes."""
        return np.asarray((self.rotations @ local[:, :, None])[:, :, 0])

    def into(self, points: FloatArray) -> FloatArray:
        """Points (n, 3) of the base in the pads' frames."""
        return np.asarray(((points - self.origins)[:, None, :] @ self.rotations)[:, 0])

    def turned_into(self, vectors: FloatArray) -> FloatArray:
        """Vectors (n, 3) of the base in the pads' axes."""
        return np.asarray((vectors[:, None, :] @ self.rotations)[:, 0])

    def jacobians(self, points: FloatArray) -> FloatArray:
        """(n, m, 3), velocity of points (n, 3) that move with the pads, per joint rate."""
        return np.asarray(self.linear + cross(self.angular, points[:, None, :]))

    def bending(self, points: FloatArray, moved: FloatArray) -> FloatArray:
        """How displacements J(q) moved of points change with q: (n, m, 3).

        A joint turns the axes of those beyond it, and moves the point.

        Args:
            points: (n, 3), m.
            moved: (m,), change of the joints, rad or m.
        """
        linear, angular = self.linear * moved[:, None], self.angular * moved[:, None]
        whole = angular.sum(axis=1, keepdims=True)
        # of the joints beyond each: the chain's order is that of the joints
        v = linear.sum(axis=1, keepdims=True) - np.cumsum(linear, axis=1)
        w = whole - np.cumsum(angular, axis=1)
        turned = cross(self.angular, v) + cross(self.linear, w)
        turned += cross(cross(self.angular, w), points[:, None, :])
        return np.asarray(turned + cross(whole, self.jacobians(points)))


class TipKinematics:
    """Fingertips of a hand that moves.

    Attributes:
        index: (m,), where the joints that move any of the fingers stand in q.
    """

    def __init__(self, hand: Hand, fingers: Sequence[Finger]) -> None:
        """Prepare for fingers."""
        self._state = MovingHand(hand, hand.neutral)
        self._joints = [finger.pad.joint_id for finger in fingers]
        moved = np.array(hand.moved_by[self._joints])
        self.index = np.flatnonzero(moved.any(axis=0))
        self._moved = moved[:, self.index, None]

    def at(self, q: FloatArray) -> Tips:
        """The fingertips at joints (nq,)."""
        data = self._state.move(q).pin_data
        poses = [data.oMi[j] for j in self._joints]
        columns = data.J[:, self.index].T
        return Tips(
            np.array([pose.rotation for pose in poses]),
            np.array([pose.translation for pose in poses]),
            self._moved * columns[:, :3],
            self._moved * columns[:, 3:],
        )
