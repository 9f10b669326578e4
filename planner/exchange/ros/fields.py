"""Fields of the messages that are written and read, and a check of plain data against them."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from planner.errors import FileFormatError, shown
from planner.exchange.yaml_text import number, table, text

FIELDS: Mapping[str, Mapping[str, str]] = MappingProxyType(
    {
        "moveit_msgs/Grasp": {
            "id": "string",
            "pre_grasp_posture": "trajectory_msgs/JointTrajectory",
            "grasp_posture": "trajectory_msgs/JointTrajectory",
            "grasp_pose": "geometry_msgs/PoseStamped",
            "grasp_quality": "float64",
            "pre_grasp_approach": "moveit_msgs/GripperTranslation",
            "post_grasp_retreat": "moveit_msgs/GripperTranslation",
            "post_place_retreat": "moveit_msgs/GripperTranslation",
            "max_contact_force": "float32",
            "allowed_touch_objects": "string[]",
        },
        "moveit_msgs/GripperTranslation": {
            "direction": "geometry_msgs/Vector3Stamped",
            "desired_distance": "float32",
            "min_distance": "float32",
        },
        "trajectory_msgs/JointTrajectory": {
            "header": "std_msgs/Header",
            "joint_names": "string[]",
            "points": "trajectory_msgs/JointTrajectoryPoint[]",
        },
        "trajectory_msgs/JointTrajectoryPoint": {
            "positions": "float64[]",
            "velocities": "float64[]",
            "accelerations": "float64[]",
            "effort": "float64[]",
            "time_from_start": "builtin_interfaces/Duration",
        },
        "geometry_msgs/PoseStamped": {"header": "std_msgs/Header", "pose": "geometry_msgs/Pose"},
        "geometry_msgs/Pose": {
            "position": "geometry_msgs/Point",
            "orientation": "geometry_msgs/Quaternion",
        },
        "geometry_msgs/Point": {"x": "float64", "y": "float64", "z": "float64"},
        "geometry_msgs/Quaternion": dict.fromkeys("xyzw", "float64"),
        "geometry_msgs/Vector3Stamped": {
            "header": "std_msgs/Header",
            "vector": "geometry_msgs/Vector3",
        },
        "geometry_msgs/Vector3": {"x": "float64", "y": "float64", "z": "float64"},
        "std_msgs/Header": {"stamp": "builtin_interfaces/Time", "frame_id": "string"},
        "builtin_interfaces/Time": {"sec": "int32", "nanosec": "uint32"},
        "builtin_interfaces/Duration": {"sec": "int32", "nanosec": "uint32"},
    }
)
"""Message -> field -> type, in the order of the message's definition."""

LEAST = {"int32": -(2**31), "uint32": 0}
MOST = {"int32": 2**31 - 1, "uint32": 2**32 - 1}
"""Ranges of the integers."""


def check_message(value: Any, kind: str, where: str) -> None:
    """See that plain data is a message; fields that are missing keep their defaults.

    Args:
        value: The data.
        kind: Its type, as in ``FIELDS``.
        where: Its place, for messages.

    Raises:
        FileFormatError: A field that the message does not have, or a value of another type.
    """
    if kind.endswith("[]"):
        if not isinstance(value, list):
            raise FileFormatError(f"{where} is a {type(value).__name__}; a list is needed")
        for i, one in enumerate(value):
            check_message(one, kind[:-2], f"{where}[{i}]")
    elif kind in FIELDS:
        fields = FIELDS[kind]
        for name, one in table(value, where).items():
            if name not in fields:
                raise FileFormatError(
                    f"{where}.{name} is no field of {kind}; it has {', '.join(fields)}"
                )
            check_message(one, fields[name], f"{where}.{name}")
    elif kind == "string":
        text(value, where)
    elif kind in MOST:
        if type(value) is not int or not LEAST[kind] <= value <= MOST[kind]:
            raise FileFormatError(
                f"{where} is {shown(value)}; an integer from {LEAST[kind]} to {MOST[kind]} is "
                "needed"
            )
    else:
        number(value, where)
