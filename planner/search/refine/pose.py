"""``GivenPose``: a hand pose as it is given, and the nearest that a refinement can start from.

What does not fit is brought in by the least change, and said: joints come within their limits, and
a wrist that the task holds elsewhere takes the base with it, so that palm and fingers stay where
they are.

Where the pads of a given hand pose belong on an object, and which fingers take part.

A pad belongs to the nearest point of the surface, unless it faces away from that: a pad that has
sunk half through a thin wall, or one beyond the edge of a box. Then the point is the first that it
does not face away from, of those nearest to a few places behind the pad.

``Movement``: how far a refinement moved a hand, part by part and as one number.

The one number ranks refinements of the same pose:

    distance^2 = mean |contact|^2 / (10 mm)^2 + |shift|^2 / (10 mm)^2
               + turn^2 / (0.2 rad)^2 + mean joint^2 / (0.2 rad)^2

A contact's displacement is measured from the point of the surface that its pad was nearest to, on
the side that the pad faces (``planner.search.refine.pose.under_pads``): a pad that only has to come
straight down to the surface, or out of it, displaces no contact.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planner.errors import HandError, TaskError, shown
from planner.failure import Failure
from planner.hands.fingers import Finger
from planner.immutable import freeze, is_pose
from planner.kinematics import moving_hand
from planner.spatial import SE3, FloatArray, pose_change, rotation_angle
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


BEHIND = np.array([0.0, 0.004, 0.008, 0.014, 0.02])
"""Distances (m) behind a pad's centre from which the surface is looked for, in this order."""

FACED = 0.0
"""Least cosine between where a pad faces and the inward normal at the point that it belongs to: the
pad does not face away from it. With 0.5 contacts count as displaced by less, and the true nearest
points of a tilted pad are missed more often."""

NEAR = 0.025
"""Gap (m) up to which a finger takes part in a given grasp: twice what the hands of data sets are
off by, and less than the distance of a finger that is meant to be away."""

FARTHEST = 0.08
"""Gap (m) up to which the nearest of the other fingers are taken where too few are near."""


@dataclass(frozen=True, kw_only=True)
class UnderPads:
    """Surface points under pads, in the object's frame.

    Attributes:
        points: (n, 3), m.
        outward: Unit normals there (n, 3).
        gaps: Signed distance of each pad's sphere from its nearest point of the surface (n,), m.
        axes: Directions in which the pads face (n, 3).
    """

    points: FloatArray
    outward: FloatArray
    gaps: FloatArray
    axes: FloatArray


def under_pads(
    task: GraspTask, T_world_base: SE3, q: FloatArray, fingers: Sequence[Finger]
) -> UnderPads:
    """Where the pads of some fingers belong on the task's object.

    Args:
        task: Hand and object.
        T_world_base: Base pose.
        q: Joints (nq,).
        fingers: The fingers.
    """
    base, state = task.T_world_object.inverse() * T_world_base, moving_hand(task.hand).move(q)
    centers = np.array([base.act(state.pad_center(f)) for f in fingers])
    axes = np.array([base.rotation @ state.pad_axis(f) for f in fingers])
    radii = np.array([f.pad.radius for f in fingers])
    n, m = len(fingers), len(BEHIND)
    behind = centers[:, None] - BEHIND[:, None] * axes[:, None]
    points, outward = (
        v.reshape(n, m, 3) for v in task.object.shape.closest_point(behind.reshape(-1, 3))
    )
    gaps = np.einsum("ik,ik->i", centers - points[:, 0], outward[:, 0]) - radii
    facing = -np.einsum("ijk,ik->ij", outward, axes)
    faced = facing >= FACED
    first = np.where(faced.any(axis=1), faced.argmax(axis=1), 0)
    each = np.arange(n)
    return UnderPads(
        points=points[each, first],
        outward=outward[each, first],
        gaps=gaps,
        axes=axes,
    )


def fingers_near(
    task: GraspTask, T_world_base: SE3, q: FloatArray
) -> tuple[tuple[str, ...], ...] | Failure:
    """Fingers that take part in a given grasp: the sets to try, the likeliest first.

    All fingers of the hand are asked, also those that are none of its default ones.

    Args:
        task: Hand and object.
        T_world_base: Base pose.
        q: Joints (nq,).

    Returns:
        At least one set of names, or why there is none: too few pads come near.
    """
    fingers = tuple(task.hand.fingers.values())
    gaps = under_pads(task, T_world_base, q, fingers).gaps
    touch = task.object.touch
    needed = set(touch.required) if touch is not None else set()
    order = sorted(range(len(fingers)), key=lambda i: (fingers[i].name not in needed, gaps[i]))
    near = sum(gaps[i] <= NEAR or fingers[i].name in needed for i in order)
    most = sum(gaps[i] <= FARTHEST for i in order)
    if most < task.fingers_needed:
        return _too_few(task, [fingers[i].name for i in order], gaps[order], most)
    first = max(near, task.fingers_needed)
    # one less, then one more: of those left the farthest goes, or the next one comes
    counts = [first, first - 1, first + 1]
    sets = [order[:k] for k in counts if task.fingers_needed <= k <= most]
    return tuple(tuple(f.name for i, f in enumerate(fingers) if i in one) for one in sets)


def _too_few(task: GraspTask, names: list[str], gaps: FloatArray, near: int) -> Failure:
    """The failure of a pose with too few pads near the object; names and gaps, nearest first."""
    said = (
        f"no pad comes near {task.object.name}"
        if near == 0
        else f"only {near} of {len(names)} pads come near {task.object.name}, and a grasp needs "
        f"{task.fingers_needed}"
    )
    listed = ", ".join(f"{n} {1e3 * g:.0f} mm" for n, g in zip(names, gaps, strict=True))
    return Failure(
        kind="too_few_pads",
        text=f"{said}: gaps are {listed} (allowed {1e3 * FARTHEST:.0f}); check the frame "
        "and the units of the pose",
        numbers={"near": float(near), "nearest": float(gaps.min())},
    )


LENGTH_UNIT, TURN_UNIT, JOINT_UNIT = 0.01, 0.2, 0.2
"""Displacement of contacts and palm (m), turn of the palm (rad) and change of joints (rad) that
count as alike. A slide of 0.2 m is as far as that for no hand, and none that we know has one."""


@dataclass(frozen=True, kw_only=True)
class Movement:
    """How far a hand moved from the given pose.

    Attributes:
        contacts: Displacement of each finger's contact on the surface (n,), m, in the order of the
            task's fingers.
        joints: Change of each joint (nq,), rad (m for slides), order of ``hand.joint_names``.
        shift: Displacement of the palm's origin, m.
        turn: Turn of the palm, rad.
    """

    contacts: FloatArray
    joints: FloatArray
    shift: float
    turn: float

    def __post_init__(self) -> None:
        """Keep read-only copies."""
        freeze(self, arrays=("contacts", "joints"))

    @classmethod
    def between(
        cls,
        given: tuple[SE3, FloatArray, FloatArray],
        reached: tuple[SE3, FloatArray, FloatArray],
    ) -> Movement:
        """From one placement of a hand to another.

        Args:
            given: Palm pose, joints (nq,), contacts (n, 3), m, in one frame.
            reached: The same there.
        """
        (palm, q, points), (palm_to, q_to, points_to) = given, reached
        return cls(
            contacts=np.linalg.norm(points_to - points, axis=1),
            joints=q_to - q,
            shift=float(np.linalg.norm(palm_to.translation - palm.translation)),
            turn=rotation_angle(palm.rotation.T @ palm_to.rotation),
        )

    @property
    def contact(self) -> float:
        """Largest displacement of a contact, m."""
        return float(self.contacts.max())

    @property
    def joint(self) -> float:
        """Largest change of a joint, rad."""
        return float(np.abs(self.joints).max())

    @property
    def distance(self) -> float:
        """All of it as one number (-), see the module."""
        squares = (
            float((self.contacts**2).mean()) / LENGTH_UNIT**2,
            self.shift**2 / LENGTH_UNIT**2,
            self.turn**2 / TURN_UNIT**2,
            float((self.joints**2).mean()) / JOINT_UNIT**2,
        )
        return float(np.sqrt(sum(squares)))

    def __str__(self) -> str:
        """One line."""
        return (
            f"contacts {1e3 * self.contact:.1f} mm, joints {self.joint:.3f} rad, palm "
            f"{1e3 * self.shift:.1f} mm and {self.turn:.3f} rad"
        )
