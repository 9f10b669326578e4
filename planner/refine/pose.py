"""``GivenPose``: a hand pose as it is given, and the nearest that a refinement can start from.

What does not fit is brought in by the least change, and said: joints come within their limits, and
a wrist that the task holds elsewhere takes the base with it, so that palm and fingers stay where
they are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planner.collision.moving_hand import moving_hand
from planner.errors import HandError, TaskError, shown
from planner.immutable import freeze, is_pose
from planner.spatial import SE3, FloatArray, pose_change
from planner.task import GraspTask
from planner.tolerances import JOINT_TOL

SAME_PLACE = 1e-6
"""Difference of pose (m, -) from a base that the task fixes that counts as none."""


@dataclass(frozen=True, kw_only=True)
class GivenPose:
    """A hand pose, given and to start from.

    Attributes:
        T_world_palm: Palm pose as given, world.
        q_given: Joints as given, or clamped where that was asked for (nq,).
        T_world_base: Base pose to start from.
        q: Joints to start from (nq,), within limits, the wrist where the task holds it.
        notes: What was changed, a sentence each.
    """

    T_world_palm: SE3
    q_given: FloatArray
    T_world_base: SE3
    q: FloatArray
    notes: tuple[str, ...]

    def __post_init__(self) -> None:
        """Keep read-only copies."""
        freeze(self, poses=("T_world_palm", "T_world_base"), arrays=("q_given", "q"))

    @classmethod
    def of(cls, task: GraspTask, T_world_base: SE3, q: FloatArray, *, clamp: bool) -> GivenPose:
        """A pose after its checks.

        Args:
            task: Hand, wrist and base.
            T_world_base: Base pose.
            q: Joints (nq,).
            clamp: Whether joints beyond their limits count as given at the limits.

        Raises:
            TaskError: The pose is none, is not finite, or is not where the task fixes the base.
            HandError: Not as many joints as the hand has, or not finite.
        """
        hand = task.hand
        _check_pose(task, T_world_base)
        given = _joints(task, q)
        inside = np.clip(given, hand.q_lower, hand.q_upper)
        notes = []
        if (over := np.abs(given - inside)).max() > JOINT_TOL:
            worst = int(over.argmax())
            count = int((over > JOINT_TOL).sum())
            notes.append(
                f"{count} joint(s) beyond their limits, {hand.joint_names[worst]} by "
                f"{over[worst]:.3f} rad, {'clamped as asked' if clamp else 'brought within'}"
            )
        T_world_palm = T_world_base * moving_hand(hand).move(given).T_base_palm
        start, wrist = inside.copy(), hand.wrist_index
        base = T_world_base if task.T_world_base is None else task.T_world_base
        if len(wrist) and not task.wrist_free:
            off = float(np.abs(start[wrist] - task.wrist_q).max())
            start[wrist] = task.wrist_q
            if off > JOINT_TOL:
                notes.append(
                    f"the wrist is {off:.3f} rad from where the task holds it; the base moves so "
                    "that the palm stays"
                    if task.T_world_base is None
                    else f"the wrist moves by {off:.3f} rad to where the task holds it"
                )
                if task.T_world_base is None:
                    base = T_world_palm * moving_hand(hand).move(start).T_base_palm.inverse()
        return cls(
            T_world_palm=T_world_palm,
            q_given=inside if clamp else given,
            T_world_base=base,
            q=start,
            notes=tuple(notes),
        )


def palm_pose(task: GraspTask, T_world_base: SE3, q: FloatArray) -> SE3:
    """Pose of the palm's body, world, at a base pose and joints (nq,)."""
    return T_world_base * moving_hand(task.hand).move(q).T_base_palm


def _joints(task: GraspTask, q: object) -> FloatArray:
    hand = task.hand
    try:
        joints = np.array(q, dtype=np.float64)
    except (TypeError, ValueError):
        raise HandError(f"q is {shown(q)}; give {hand.nq} numbers") from None
    if joints.shape != (hand.nq,):
        raise HandError(
            f"q has shape {joints.shape}; {hand.name} has {hand.nq} joints: "
            f"{', '.join(hand.joint_names)}"
        )
    if not np.isfinite(joints).all():
        bad = [hand.joint_names[i] for i in np.flatnonzero(~np.isfinite(joints))]
        raise HandError(f"q holds NaN or infinity, for {', '.join(bad)}; give finite joints")
    return joints


def _check_pose(task: GraspTask, T_world_base: object) -> None:
    if not is_pose(T_world_base):
        raise TaskError(
            f"T_world_base is {shown(T_world_base)}; give a pinocchio.SE3, for example "
            "planner.spatial.pose_from_wxyz(position, quaternion)"
        )
    pose: SE3 = T_world_base
    if not np.isfinite(pose.homogeneous).all():
        raise TaskError("T_world_base holds NaN or infinity; give a finite pose")
    off = np.abs(pose.rotation.T @ pose.rotation - np.eye(3)).max()
    if off > ROTATION_TOL or np.linalg.det(pose.rotation) < 0:
        raise TaskError(
            f"T_world_base: its matrix is no rotation (off by {off:.1e}, determinant "
            f"{np.linalg.det(pose.rotation):.2f}); give an orthonormal, right-handed one"
        )
    if task.T_world_base is not None:
        gap = np.abs((task.T_world_base.inverse() * pose).homogeneous - np.eye(4)).max()
        if gap > SAME_PLACE:
            length, angle = pose_change(task.T_world_base, pose)
            raise TaskError(
                f"the task fixes the base {length:.1f} mm and {angle:.1f} degrees from the given "
                "pose; make the task with the given T_world_base, or give the pose of the task"
            )


ROTATION_TOL = 1e-6
"""How far (-) a rotation matrix may be from orthonormal: rounding of what was read from text."""
