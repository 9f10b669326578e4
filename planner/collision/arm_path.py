"""What an arm has to do around a grasp: come in straight, and lift. Both are paths of its joints.

The palm moves straight and does not turn; the fingers stay as they are. A path is a row of arm
postures, and between two of them the joints move in proportion. It is checked without a gap. From a
configuration with clearance d, a step dq of the arm's joints moves no point of arm or hand by more
than sum |dq_j| r_j, with r_j the largest distance of a point downstream of joint j from its axis at
that configuration (1 for a slide): take the joints one after the other, root first, and each turns
what is downstream of it as it stood before. So any step with that sum below d is free.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise, product
from typing import Any

import numpy as np
import pinocchio as pin

from planner.collision.world import Clearance, CollisionWorld
from planner.failure import Failure
from planner.hands.fingers import Side
from planner.hands.hand import Hand
from planner.immutable import freeze
from planner.kinematics import (
    LARGEST_TURN,
    HandState,
    follow,
    joint_axes,
    palm_pose,
    palm_poses,
    straight_path,
)
from planner.spatial import SE3, FloatArray, rotation_angle
from planner.task import GraspTask
from planner.tolerances import PENETRATION_TOL

__all__ = [
    "LIFT_HEIGHT",
    "ArmPath",
    "beyond_limits",
    "find_lift",
    "lift_height",
    "onto_arms",
    "retreats",
    "verify_approach_line",
    "verify_arm_path",
    "verify_lift",
]

LIFT_HEIGHT = 0.1
"""How far (m) upwards a grasp must be liftable by the arm: the lift of a trial."""

PAIR_LIFT_HEIGHT = 0.2
"""The same (m) of two arms: a large object is carried over what stands about."""

LEAST_STEP = 5e-4
"""Shortest step (m) of any point in the check of a path: less than the clearance of an approach, so
that nothing is jumped over."""

LIMIT_TOL = 1e-6
"""How far (rad, m) a posture of a path may be beyond a joint's range: rounding in a file."""

LINE_TOL = 1e-3
"""How far (m) the palm may leave the straight line at a posture of the path."""

TURN_TOL = 5e-3
"""How far (rad) it may turn there: 1 mm at a fingertip 0.2 m away."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ArmPath:
    """The arm's part of a plan, rows of arm postures in the order of ``hand.arm_index``.

    Two arms go in step: a row holds a posture of each.

    Attributes:
        approach: (m, n), from the start to the grasp; fingers at the pre-grasp.
        lift: (k, n), from the grasp upwards by ``lift_height``; fingers at the grasp.
    """

    approach: FloatArray
    lift: FloatArray

    def __post_init__(self) -> None:
        """Keep copies that nobody changes."""
        freeze(self, arrays=("approach", "lift"))


def lift_height(hand: Hand) -> float:
    """How far (m) the plan of a hand on an arm lifts, or of two."""
    return PAIR_LIFT_HEIGHT if hand.pair else LIFT_HEIGHT


def retreats(
    hand: Hand, T_world_base: SE3, q: FloatArray, ways: list[FloatArray]
) -> Iterator[FloatArray]:
    """Arm paths (m, n) straight in to q (nq,), one for each way, m, world, the arm can go.

    A way is (3,), of two hands (2, 3).
    """
    for way in ways:
        path = straight_path(hand, q, way @ T_world_base.rotation)
        if path is not None:
            yield path[::-1].copy()


def onto_arms(world: CollisionWorld, T_world_base: SE3, q: FloatArray) -> FloatArray | Failure:
    """Joints (nq,) of two hands on arms with all links where carriages have them; or why not.

    Of several postures of both arms the first is taken that touches nothing, those before whose
    actuators have most left where the palms press with the grip.

    Args:
        world: True geometry of the task with the hands on arms.
        T_world_base: Base pose of the same on carriages, ``task.on_carriages``.
        q: Joints of those.
    """
    task = world.task
    hand, other = task.hand, task.on_carriages.hand
    out, data = hand.at_rest, other.pin_model.createData()
    pin.framesForwardKinematics(other.pin_model, data, q)
    postures = []
    for side, there in zip(hand.pair, other.pair, strict=True):
        joints = [hand.joint_index(other.joint_names[k]) for k in there.joints]
        out[joints] = q[there.joints]
        palm = data.oMf[other.pin_model.getBodyId(there.palm_body)]
        root = SE3(task.T_world_base) * side.T_base_root
        found = []
        for turn in WRIST_TURNS:
            start, last = out[side.joints], side.alone.arm.chain[-1]
            start[last] = np.clip(
                start[last] + turn, side.alone.q_lower[last], side.alone.q_upper[last]
            )
            found.append(follow(side.alone, root.inverse() * T_world_base * palm, start))
        reached = [(_load(task, side, root, one.q), one.q) for one in found if one.there]
        if not reached:
            least = min(one.distance for one in found)
            return Failure(
                kind="arm_unreachable",
                text=f"the arm of {side.name!r} comes no nearer than {1e3 * least:.0f} mm to where "
                "its palm lies",
                numbers={"distance": least},
            )
        postures.append(reached)
    pairs = sorted(product(*postures), key=lambda both: max(load for load, _ in both))
    for both in (*pairs, pairs[0]):
        for side, (_, posture) in zip(hand.pair, both, strict=True):
            out[side.joints] = posture
        held = task.T_world_object
        if world.nearest_on_arm(task.T_world_base, out, T_world_object=held).distance > 0.0:
            break
    return out


WRIST_TURNS = (0.0, 1.0, -1.0, 2.0, -2.0)
"""Turns (rad) of an arm's last joint from its ready posture, where inverse kinematics starts: an
arm of seven joints has another posture for each."""


def _load(task: GraspTask, side: Side, T_world_root: SE3, q: FloatArray) -> float:
    """Largest share (-) of a limit that an arm's actuators use at q while the palm presses."""
    alone = side.alone
    state, turn = HandState(alone, q), T_world_root.rotation
    palm, joint = state.T_base_palm, int(alone.pin_model.frames[alone.palm_frame_id].parentJoint)
    torque = state.gravity_torque(turn.T @ task.gravity)
    press = task.grip_force * (palm.rotation @ alone.palm_normal)
    torque += press @ state.point_jacobian(joint, palm.translation)[:3]
    force, _ = alone.actuation.split_torque(q, torque)
    arm = alone.actuation.moment[:, alone.arm_index].any(axis=1)
    return float((np.abs(force) / np.abs(alone.actuation.force_limits(q)).min(axis=1))[arm].max())


def find_lift(world: CollisionWorld, T_world_base: SE3, q: FloatArray) -> FloatArray | Failure:
    """Arm path (k, n) straight up from a grasp q (nq,) that touches nothing; or why there is none.

    The object moves with the palm. That it is clear of obstacles is not looked at, as it is not for
    a floating hand.
    """
    hand, height = world.task.hand, lift_height(world.task.hand)
    path = straight_path(hand, q, T_world_base.rotation.T @ np.array([0.0, 0.0, height]))
    if path is None:
        who = "arms cannot together" if hand.pair else "arm cannot"
        limits = "their limits" if hand.pair else "its limits"
        return Failure(
            kind="arm_unreachable",
            text=f"the {who} lift the object straight by {height:g} m within {limits}",
        )
    return verify_lift(world, T_world_base, q, path) or path


def verify_lift(
    world: CollisionWorld, T_world_base: SE3, q: FloatArray, path: FloatArray
) -> Failure | None:
    """What is wrong with a lift (k, n) from a grasp q (nq,), None if nothing is."""
    up = np.array([0.0, 0.0, lift_height(world.task.hand)])
    failure = _verify_line(world.task.hand, T_world_base, q, path, up, "lift")
    failure = failure or verify_arm_path(world, T_world_base, q, path, clearance=0.0, held=True)
    if not world.task.hand.pair:  # what two arms press with is known with the forces alone
        failure = failure or _verify_torques(world.task, T_world_base, q, path)
    return None if failure is None else failure.at("the lift")


def verify_approach_line(
    hand: Hand, T_world_base: SE3, q: FloatArray, path: FloatArray
) -> Failure | None:
    """What is wrong with the line of an approach that ends at q (nq,), None if nothing is."""
    ends = path[[0, -1]] if path.ndim == 2 and len(path) else path
    if ends.shape != (2, len(hand.arm_index)):
        text = f"the approach has shape {path.shape}; it needs a column per joint of the arm"
        return Failure(kind="arm_path", text=text)
    first = q.copy()
    first[hand.arm_index] = ends[0]
    both = zip(palm_poses(hand, first), palm_poses(hand, q), strict=True)
    shift = np.array([there.translation - here.translation for there, here in both])
    way = shift @ T_world_base.rotation.T
    return _verify_line(hand, T_world_base, q, path[::-1], way, "approach")


def _verify_line(
    hand: Hand,
    T_world_base: SE3,
    q: FloatArray,
    path: FloatArray,
    shift: FloatArray,
    what: str,
) -> Failure | None:
    """Whether a path (m, n) that begins at q (nq,) is one the arm can go, straight by a shift.

    The shift is one (3,), or one for each palm (k, 3), m, world.
    """
    index = hand.arm_index

    def failure(text: str) -> Failure:
        return Failure(kind="arm_path", text=text)

    if path.ndim != 2 or path.shape[1] != len(index) or len(path) < 2:
        return failure(f"its {what} has shape {path.shape}; it needs rows of {len(index)} joints")
    beyond = np.maximum(hand.q_lower[index] - path, path - hand.q_upper[index])
    if not beyond.max() <= LIMIT_TOL:
        return failure(f"a joint of the arm is {beyond.max():.1e} beyond its range")
    if np.abs(path[0] - q[index]).max() > LIMIT_TOL:
        return failure("the arm's path does not meet the grasp")
    if np.abs(np.diff(path, axis=0)).max() > LARGEST_TURN:
        return failure("the arm's path jumps")
    begins, joints = palm_poses(hand, q), q.copy()
    goals = np.broadcast_to(shift @ T_world_base.rotation, (len(begins), 3))
    for share, posture in zip(np.linspace(0.0, 1.0, len(path)), path, strict=True):
        joints[index] = posture
        for begin, palm, goal in zip(begins, palm_poses(hand, joints), goals, strict=True):
            off = float(np.linalg.norm(palm.translation - begin.translation - share * goal))
            turn = rotation_angle(begin.rotation.T @ palm.rotation)
            if off > LINE_TOL or turn > TURN_TOL:
                return failure(
                    f"the palm leaves the line by {1e3 * off:.1f} mm and {np.rad2deg(turn):.1f} deg"
                )
    return None


def verify_arm_path(
    world: CollisionWorld,
    T_world_base: SE3,
    q: FloatArray,
    path: FloatArray,
    *,
    clearance: float,
    held: bool = False,
) -> Failure | None:
    """What the arm or the hand comes nearer to than a clearance (m) along a path (m, n).

    Args:
        world: True geometry of the task.
        T_world_base: Pose of the arm's root.
        q: Joints (nq,); those of the arm are taken from the path.
        path: Arm postures (m, n).
        clearance: Least distance, m.
        held: Whether the object moves with the palm, which may touch it then.
    """
    hand = world.task.hand
    at = np.array(q, dtype=np.float64)
    arm, radii = hand.arm_index, _Radii(hand)
    palm_at_grasp = palm_pose(hand, q)
    for begin, end in pairwise(path):
        share, sweep = 0.0, 0.0
        steps = np.abs(end - begin)
        while share < 1.0:
            at[arm] = begin + share * (end - begin)
            if share == 0.0:
                here = radii.at(at)
                # on the way nothing gets farther from an axis than it moves
                sweep = float(steps @ (here + steps @ here))
            T_object = None
            if held:
                palm = world.moving.move(at).T_base_palm
                moved = T_world_base * palm * palm_at_grasp.inverse()
                T_object = moved * T_world_base.inverse() * world.task.T_world_object
            nearest = world.nearest_on_arm(T_world_base, at, T_world_object=T_object)
            if nearest.distance < clearance - (PENETRATION_TOL if held else 0.0):
                return _too_near(nearest)
            if sweep == 0.0:
                break
            share += max(nearest.distance - clearance, LEAST_STEP) / sweep
    at[arm] = path[-1]
    if not held:
        nearest = world.nearest_on_arm(T_world_base, at)
        if nearest.distance < clearance:
            return _too_near(nearest)
    return None


def _too_near(nearest: Clearance) -> Failure:
    numbers = {"distance": nearest.distance}
    return Failure(kind="arm_collision", text=str(nearest), numbers=numbers)


def _verify_torques(
    task: GraspTask, T_world_base: SE3, q: FloatArray, path: FloatArray
) -> Failure | None:
    """Whether the arm's actuators carry arm, hand and object at rest along a path (m, n)."""
    hand, joints = task.hand, np.array(q, dtype=np.float64)
    gravity = T_world_base.rotation.T @ task.gravity
    in_palm = palm_pose(hand, q).inverse() * T_world_base.inverse() * task.T_world_object
    palm = int(hand.pin_model.frames[hand.palm_frame_id].parentJoint)
    for posture in path:
        joints[hand.arm_index] = posture
        state = HandState(hand, joints)
        at = (state.T_base_palm * in_palm).translation
        torque = state.gravity_torque(gravity)
        torque -= task.object.mass * gravity @ state.point_jacobian(palm, at)[:3]
        if (failure := beyond_limits(hand, joints, torque)) is not None:
            return failure
    return None


def beyond_limits(
    hand: Hand, q: FloatArray, torque: FloatArray, tolerance: float = 0.0
) -> Failure | None:
    """The arm's actuator that is farthest beyond its limits at rest at q (nq,); None if none is.

    Args:
        hand: On an arm, or two.
        q: Joints (nq,).
        torque: That the actuators have to give (nq,), N m.
        tolerance: How far (N m) one may be beyond its limit.
    """
    arm = hand.actuation.moment[:, hand.arm_index].any(axis=1)
    force, _ = hand.actuation.split_torque(q, torque)
    low, high = hand.actuation.force_limits(q).T
    beyond = np.where(arm, np.maximum(low - force, force - high), -np.inf)
    worst = int(np.argmax(beyond))
    if beyond[worst] <= tolerance:
        return None
    return Failure(
        kind="arm_torque",
        text=f"{hand.actuation.names[worst]} would have to give {force[worst]:.1f}, beyond "
        f"its limits [{low[worst]:.1f}, {high[worst]:.1f}]",
        numbers={"force": float(force[worst])},
    )


class _Radii:
    """Largest distances of what is downstream of the arm's joints from their axes."""

    def __init__(self, hand: Hand) -> None:
        model = hand.pin_model
        self._hand = hand
        self._axes = joint_axes(model)
        self._of_joint = np.array([g.joint_id for g in hand.geometries])
        self._centers = np.array([g.T_joint_geometry.translation for g in hand.geometries])
        self._sizes = np.array([_bounding_radius(g.geometry) for g in hand.geometries])
        self._below = [
            np.array([k + 1 in list(model.supports[int(j)]) for j in self._of_joint])
            for k in hand.arm_index
        ]

    def at(self, q: FloatArray) -> FloatArray:
        """(n,), m per rad, and 1 for slides."""
        state = HandState(self._hand, q)
        poses = [state.joint_pose(j) for j in range(self._hand.pin_model.njoints)]
        turn = np.array([p.rotation for p in poses])[self._of_joint]
        shift = np.array([p.translation for p in poses])[self._of_joint]
        centers = np.einsum("nij,nj->ni", turn, self._centers) + shift
        out = np.zeros(len(self._below))
        for i, (k, below) in enumerate(zip(self._hand.arm_index, self._below, strict=True)):
            if not below.any():
                continue
            pose, axis = poses[int(k) + 1], self._axes[int(k) + 1]
            if not axis[3:].any():
                out[i] = 1.0
                continue
            across = np.cross(centers[below] - pose.translation, pose.rotation @ axis[3:])
            out[i] = (np.linalg.norm(across, axis=1) + self._sizes[below]).max()
        return out


def _bounding_radius(geometry: Any) -> float:
    """Radius (m) of the ball about the geometry's origin that contains it."""
    geometry.computeLocalAABB()
    box = geometry.aabb_local
    return float(np.linalg.norm(np.maximum(np.abs(box.min_), np.abs(box.max_))))
