"""``SymbolicHand``: placements of joints and points as CasADi expressions of q.

The Pinocchio wheel on PyPI comes without ``pinocchio.casadi``; hinges and slides need no more than
Rodrigues' formula. The twin is checked against Pinocchio and MuJoCo to 1e-10.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from planner.hands.fingers import Finger
from planner.hands.hand import Hand
from planner.kinematics.state import joint_axes
from planner.spatial import FloatArray, skew

__all__ = ["SymbolicHand"]


@dataclass(frozen=True)
class _Placement:
    """Rotation (3, 3) and translation (3,) as CasADi expressions."""

    rotation: Any
    translation: Any


class SymbolicHand:
    """Kinematics of a hand as CasADi SX expressions of a given q.

    Everything is in the hand's base frame, as in ``HandState``. With ``from_flange`` the last joint
    of the arm that carries the hand and all that it moves is in that joint's frame instead.
    """

    def __init__(self, hand: Hand, q: Any, *, from_flange: bool = False) -> None:
        """Build the placements of all joints.

        Args:
            hand: The hand.
            q: CasADi SX column (nq, 1), rad or m.
            from_flange: Whether to leave out where the arm puts its last joint, see ``flange``.
        """
        self.hand = hand
        self.q = q
        model = hand.pin_model
        axes = joint_axes(model)
        self._axes = axes
        cut = hand.arm.flange if from_flange and hand.arm is not None else 0
        self._flange = self._root = _Placement(ca.SX.eye(3), ca.SX.zeros(3))
        self._joints = [self._root]
        self._moved = [cut == 0]
        for j in range(1, model.njoints):
            parent = self._joints[model.parents[j]]
            fixed = model.jointPlacements[j]
            rotation = parent.rotation @ fixed.rotation
            translation = parent.translation + parent.rotation @ fixed.translation
            angle = q[int(model.joints[j].idx_q)]
            linear, angular = axes[j, :3], axes[j, 3:]
            if np.any(angular):
                rotation = rotation @ _rodrigues(angular, angle)
            else:
                translation = translation + rotation @ (linear * angle)
            placement = _Placement(rotation, translation)
            if j == cut:
                self._flange, placement = placement, self._root
            self._joints.append(placement)
            self._moved.append(j == cut or self._moved[model.parents[j]])

    @property
    def flange(self) -> tuple[Any, Any]:
        """Rotation (3, 3) and origin (3,) of the arm's last joint in the base, if cut there."""
        return self._flange.rotation, self._flange.translation

    def is_cut_off(self, joint_id: int) -> bool:
        """Whether a joint is upstream of the cut, in the base's frame while the hand is not."""
        return not self._moved[joint_id]

    def joint(self, joint_id: int) -> tuple[Any, Any]:
        """Rotation (3, 3) and origin (3,) of a joint's frame in the base."""
        placement = self._joints[joint_id]
        return placement.rotation, placement.translation

    def point(self, joint_id: int, local: FloatArray) -> Any:
        """A point (3,), m, fixed in a joint's frame, in the base."""
        placement = self._joints[joint_id]
        return placement.translation + placement.rotation @ np.asarray(local)

    def direction(self, joint_id: int, local: FloatArray) -> Any:
        """A direction (3,) fixed in a joint's frame, in the base."""
        return self._joints[joint_id].rotation @ np.asarray(local)

    def tip(self, finger: Finger) -> tuple[Any, Any]:
        """Rotation (3, 3) and origin (3,) of a finger's tip frame in the base."""
        frame = self.hand.pin_model.frames[finger.tip_frame_id]
        placement = self._joints[frame.parentJoint]
        return (
            placement.rotation @ frame.placement.rotation,
            placement.translation + placement.rotation @ frame.placement.translation,
        )

    def tip_jacobian(self, finger: Finger) -> Any:
        """Jacobian (6, n) of the tip frame over the finger's joints, rows as in ``HandState``."""
        _, origin = self.tip(finger)
        model = self.hand.pin_model
        columns = []
        for name in finger.joints:
            j = model.getJointId(name)
            placement = self._joints[j]
            linear = placement.rotation @ self._axes[j, :3]
            angular = placement.rotation @ self._axes[j, 3:]
            arm = origin - placement.translation
            columns.append(ca.vertcat(linear + ca.cross(angular, arm), angular))
        return ca.horzcat(*columns)

    def joint_columns(self) -> Any:
        """Twist (6, nq) [linear; angular] of what passes the origin, per velocity of each joint.

        In the frame of the joint's placement: what it moves goes at linear + angular x point.
        """
        columns = []
        for j in range(1, self.hand.pin_model.njoints):
            placement = self._joints[j]
            angular = placement.rotation @ self._axes[j, 3:]
            linear = placement.rotation @ self._axes[j, :3]
            moment = ca.cross(angular, placement.translation)
            columns.append(ca.vertcat(linear - moment, angular))
        return ca.horzcat(*columns)

    def joint_torque(self, joint_name: str, point: Any, force: Any) -> Any:
        """Torque (N m, or force in N of a slide) of a joint that presses ``force`` at ``point``.

        The static reaction tau = J^T f of one joint upstream of the point, both in the base.
        """
        j = self.hand.pin_model.getJointId(joint_name)
        placement = self._joints[j]
        linear = placement.rotation @ self._axes[j, :3]
        angular = placement.rotation @ self._axes[j, 3:]
        arm = point - placement.translation
        return ca.dot(linear + ca.cross(angular, arm), force)


def _rodrigues(axis: FloatArray, angle: Any) -> Any:
    """Rotation by ``angle`` about a unit axis: I + sin(a) K + (1 - cos(a)) K^2."""
    k = skew(axis)
    return ca.DM.eye(3) + ca.sin(angle) * k + (1 - ca.cos(angle)) * (k @ k)
