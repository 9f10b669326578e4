"""``ros2-grasp``: plans as moveit_msgs/Grasp; see the package for whose definitions these are.

``grasp_pose`` is the pose of the hand's base, or of another body that is asked for, in the frame of
the object's own file, so that a message holds wherever the object is; or in the world.
``grasp_quality`` is the normalised min-weight of the contacts, ``max_contact_force`` the largest
planned contact force. Efforts of ``grasp_posture`` are what actuators exert on the joints for the
planned forces.

``ros2-trajectory``: plans and movements as trajectory_msgs/JointTrajectory, by joint name.

Grasp plans, motions, gaits and manipulation plans all have a ``joint_trajectory``; what the base of
a hand without an arm does meanwhile is not in the message.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from planner.errors import FileFormatError
from planner.exchange.export import AnyPlan
from planner.exchange.formats import (
    GraspFormat,
    ImportedGrasp,
    ImportedGrasps,
    Reading,
    Writing,
    register_format,
)
from planner.exchange.joints import (
    T_base_body,
    T_file_object,
    channels_of,
    completed_joints,
    need_no_arm,
    object_frame,
)
from planner.exchange.ros.messages import (
    check_message,
    joint_trajectory,
    pose_stamped,
    read_messages,
    translation,
    write_messages,
)
from planner.exchange.yaml_text import head_of, member, number, numbers, pose_of
from planner.hands.hand import Hand
from planner.plan import GraspPlan
from planner.spatial import SE3, FloatArray
from planner.system.package import written_by

GRASP = "moveit_msgs/Grasp"

CLOSE_S = 1.0
"""Time to close from the pre-grasp to the grasp, s, as in ``GraspPlan.joint_trajectory``."""

LIFT = 0.08
"""How far the hand is to lift, m, as in ``ManipulationPlan.joint_trajectory``; not planned, and so
no part of it is asked for as the least."""


def grasp_message(plan: GraspPlan, name: str, writing: Writing | None = None) -> dict[str, Any]:
    """A plan as plain data of moveit_msgs/Grasp.

    Args:
        plan: Of a hand without an arm.
        name: The message's id.
        writing: Names of frames and joints; ours if None.

    Raises:
        TaskError: The hand is on an arm, or names do not fit it.
    """
    told = writing or Writing()
    task = plan.task
    hand = need_no_arm(task, ROS_GRASP.name)
    channels = channels_of(hand, told)
    thing = object_frame(task, told)
    frame, T_frame_world = told.world_frame, SE3.Identity()
    if not frame:
        frame, T_frame_world = thing, T_file_object(task) * task.T_world_object.inverse()
    way = plan.T_world_base.translation - plan.T_world_base_start.translation
    turn, pull = T_frame_world.rotation, float(np.linalg.norm(task.gravity))
    up = -task.gravity / pull if pull else -way / max(float(np.linalg.norm(way)), 1e-12)
    return {
        "id": name,
        "pre_grasp_posture": joint_trajectory(
            channels.names, [0.0], channels.values(plan.q_pregrasp)[None]
        ),
        "grasp_posture": joint_trajectory(
            channels.names,
            [CLOSE_S],
            channels.values(plan.q)[None],
            effort=_efforts(plan, told, channels.matrix)[None],
        ),
        "grasp_pose": pose_stamped(
            T_frame_world * plan.T_world_base * T_base_body(hand, plan.q, told.base_body), frame
        ),
        "grasp_quality": float(plan.quality.closure.normalised_min_weight),
        "pre_grasp_approach": translation(turn @ way, frame, float(np.linalg.norm(way))),
        "post_grasp_retreat": translation(LIFT * (turn @ up), frame, 0.0),
        "post_place_retreat": translation(-(turn @ way), frame, float(np.linalg.norm(way))),
        "max_contact_force": float(np.linalg.norm(plan.contacts.forces[:, :3], axis=1).max()),
        "allowed_touch_objects": [thing],
    }


def write_ros_grasps(plans: Sequence[GraspPlan], path: Path, writing: Writing) -> tuple[Path, ...]:
    """Write plans as messages of moveit_msgs/Grasp.

    Raises:
        TaskError: A hand is on an arm, or names do not fit it.
        FileFormatError: The file cannot be written.
    """
    messages = [grasp_message(plan, f"grasp_{i}", writing) for i, plan in enumerate(plans)]
    hand = plans[0].task.hand
    comments = (
        f"{written_by()}: {GRASP} of {hand.name}; grasp_pose is of the body "
        f"{writing.base_body or hand.description.base_body}",
        "m, rad, N, N m; grasp_quality: normalised min-weight of the contacts",
        *channels_of(hand, writing).said,
    )
    return write_messages(messages, path, comments)


def read_ros_grasps(path: Path, hand: Hand, reading: Reading) -> ImportedGrasps:
    """Read messages of moveit_msgs/Grasp for a hand; a pose is taken to be in the object's frame.

    Raises:
        FileFormatError: A message is damaged or for another hand; the message names the place.
    """
    if reading.quaternion is not None:
        raise FileFormatError(
            f"{path} says x, y, z and w by name, and an order of {reading.quaternion} is given as "
            "well; leave that out"
        )
    grasps = tuple(_read(data, where, hand, reading) for where, data in read_messages(path))
    return ImportedGrasps(
        source=path,
        format=ROS_GRASP.name,
        hand="",
        grasps=grasps,
        assumed=(
            f"grasp_pose is of the body {reading.base_body or hand.description.base_body!r} of "
            f"{hand.name}",
            f"{grasps[0].object or 'the frame without a name'} is the frame of the object's file",
        ),
    )


def _read(data: Any, where: str, hand: Hand, reading: Reading) -> ImportedGrasp:
    check_message(data, GRASP, where)
    stamped, at = _inside(data, where, "grasp_pose")
    pose, at = _inside(stamped, at, "pose")
    position = _inside(pose, at, "position")
    turn = _inside(pose, at, "orientation")
    T_object_body = pose_of(
        _values(*position, "xyz") * (reading.unit or 1.0), _values(*turn, "wxyz"), turn[1]
    )
    q = _posture(data, where, "grasp_posture", hand, reading)
    opened = None
    if data.get("pre_grasp_posture", {}).get("points"):
        opened = _posture(data, where, "pre_grasp_posture", hand, reading)
    quality = data.get("grasp_quality")
    return ImportedGrasp(
        name=str(data.get("id", "")) or where.rpartition(": ")[2],
        T_object_base=T_object_body * T_base_body(hand, q, reading.base_body).inverse(),
        q=q,
        q_pregrasp=opened,
        object=str(stamped.get("header", {}).get("frame_id", "")),
        confidence=None if quality is None else number(quality, f"{where}.grasp_quality"),
    )


def _inside(data: Mapping[str, Any], where: str, key: str) -> tuple[Any, str]:
    """A field that must be there, and its place."""
    return member(data, key, where), f"{where}.{key}"


def _values(data: Mapping[str, Any], where: str, keys: str) -> FloatArray:
    return np.array([number(member(data, k, where), f"{where}.{k}") for k in keys])


def _posture(
    data: Mapping[str, Any], where: str, key: str, hand: Hand, reading: Reading
) -> FloatArray:
    """Joints (nq,) at the last point of a posture."""
    trajectory, at = _inside(data, where, key)
    names = member(trajectory, "joint_names", at)
    points = member(trajectory, "points", at)
    if not points:
        raise FileFormatError(f"{at}.points is empty; a posture has a point")
    last = f"{at}.points[{len(points) - 1}]"
    values = numbers(member(points[-1], "positions", last), len(names), f"{last}.positions")
    return completed_joints(hand, names, values, where=at, other_names=reading.rename)


def _efforts(plan: GraspPlan, writing: Writing, matrix: FloatArray) -> FloatArray:
    """What actuators exert for the planned forces (n,): on the joints told, or each by itself."""
    forces = plan.forces.actuator_forces
    if writing.by == "actuators":
        return forces
    return np.asarray(matrix @ (plan.task.hand.actuation.moment.T @ forces))


def _recognises(path: Path) -> bool:
    head = head_of(path)
    return "grasp_posture" in head and "joint_names" in head


ROS_GRASP = register_format(
    GraspFormat(
        name="ros2-grasp",
        title=f"{GRASP} of ROS 2 as YAML, a document per grasp, or a list as JSON",
        suffixes=(".yaml", ".yml", ".json"),
        loses=(
            "the object's shape and mass, contacts (the largest force stays), friction, table and "
            "obstacles; of the approach its direction and length stay"
        ),
        recognises=_recognises,
        read=read_ros_grasps,
        write=write_ros_grasps,
        heeds=frozenset({"rename", "by", "object_frame", "hand_frame", "base_body", "world_frame"}),
    )
)


TRAJECTORY = "trajectory_msgs/JointTrajectory"


def trajectory_message(plan: AnyPlan, writing: Writing | None = None) -> dict[str, Any]:
    """A plan as plain data of trajectory_msgs/JointTrajectory.

    Args:
        plan: Of any kind.
        writing: Names of joints; ours if None.

    Raises:
        NotFoundError: ``writing`` renames what is not there.
        TaskError: Two joints would have one name.
    """
    way = plan.joint_trajectory()
    channels = channels_of(plan.task.hand, writing or Writing())
    return joint_trajectory(channels.names, way.times.tolist(), channels.values(way.positions))


def write_ros_trajectories(
    plans: Sequence[AnyPlan], path: Path, writing: Writing
) -> tuple[Path, ...]:
    """Write plans as messages of trajectory_msgs/JointTrajectory.

    Raises:
        NotFoundError: ``writing`` renames what is not there.
        TaskError: Two joints would have one name.
        FileFormatError: The file cannot be written.
    """
    hand = plans[0].task.hand
    comments = (
        f"{written_by()}: {TRAJECTORY} of {hand.name}; rad, m",
        *channels_of(hand, writing).said,
    )
    return write_messages([trajectory_message(plan, writing) for plan in plans], path, comments)


ROS_TRAJECTORY = register_format(
    GraspFormat(
        name="ros2-trajectory",
        title=f"{TRAJECTORY} of ROS 2 as YAML, a document per plan, or a list as JSON",
        suffixes=(".yaml", ".yml", ".json"),
        loses=(
            "all but joint positions over time: the pose of a hand without an arm, phases, "
            "contacts and forces, the object"
        ),
        recognises=lambda path: False,
        write=write_ros_trajectories,
        heeds=frozenset({"rename", "by"}),
        movements=True,
    )
)
