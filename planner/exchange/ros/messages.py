"""Fields of the messages that are written and read, and a check of plain data against them.

Parts of messages as plain data: headers, times, poses, trajectories; and files of messages.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from planner.errors import FileFormatError, shown
from planner.exchange.yaml_text import number, read_documents, table, text, yaml_text
from planner.files import whole_file
from planner.spatial import SE3, FloatArray, pose_to_wxyz

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


NANO = 1_000_000_000
"""Nanoseconds in a second."""

LONGEST = 2**31
"""Seconds that a Duration cannot hold any more."""


def duration(seconds: float) -> dict[str, int]:
    """A builtin_interfaces/Duration or Time, to the nanosecond.

    Raises:
        FileFormatError: Negative, not finite, or too long for the message.
    """
    if not 0.0 <= seconds < LONGEST - 1:
        raise FileFormatError(f"a time of {seconds} s is no ROS duration; give 0 to 2^31 - 1 s")
    sec, nanosec = divmod(round(seconds * NANO), NANO)
    return {"sec": sec, "nanosec": nanosec}


def header(frame: str) -> dict[str, Any]:
    """A std_msgs/Header of no certain time: of a trajectory, begin at once."""
    return {"stamp": duration(0.0), "frame_id": frame}


def vector(values: FloatArray) -> dict[str, float]:
    """A geometry_msgs/Point or Vector3 of (3,)."""
    return dict(zip("xyz", np.asarray(values, dtype=np.float64).tolist(), strict=True))


def pose_stamped(pose: SE3, frame: str) -> dict[str, Any]:
    """A geometry_msgs/PoseStamped."""
    position, (w, *xyz) = pose_to_wxyz(pose)
    turn = {**vector(np.array(xyz)), "w": float(w)}
    return {"header": header(frame), "pose": {"position": vector(position), "orientation": turn}}


def translation(way: FloatArray, frame: str, least: float) -> dict[str, Any]:
    """A moveit_msgs/GripperTranslation.

    Args:
        way: (3,), m, in the frame.
        frame: Its name.
        least: Shortest way that is of use, m.
    """
    length = float(np.linalg.norm(way))
    direction = way / length if length else np.zeros(3)
    return {
        "direction": {"header": header(frame), "vector": vector(direction)},
        "desired_distance": length,
        "min_distance": least,
    }


def joint_trajectory(
    names: Sequence[str],
    times: Sequence[float],
    positions: FloatArray,
    effort: FloatArray | None = None,
) -> dict[str, Any]:
    """A trajectory_msgs/JointTrajectory.

    Args:
        names: n names.
        times: m times, s.
        positions: (m, n), rad or m.
        effort: (m, n), N m or N; left out if None.
    """
    efforts = np.zeros((len(times), 0)) if effort is None else effort
    return {
        "header": header(""),
        "joint_names": list(names),
        "points": [
            {
                "positions": q.tolist(),
                "velocities": [],
                "accelerations": [],
                "effort": f.tolist(),
                "time_from_start": duration(float(t)),
            }
            for t, q, f in zip(times, positions, efforts, strict=True)
        ],
    }


def write_messages(
    messages: Sequence[dict[str, Any]], path: Path, comments: Sequence[str]
) -> tuple[Path, ...]:
    """Write messages whole or not at all: JSON for a path that ends in .json, else YAML.

    Args:
        messages: Plain data.
        path: The file.
        comments: Lines above the YAML; JSON has no comments.

    Raises:
        FileFormatError: The folder does not exist or cannot be written.
    """
    if path.suffix.lower() == ".json":
        written = json.dumps(messages, indent=1, allow_nan=False) + "\n"
    else:
        written = yaml_text(messages, comments)
    with whole_file(path) as stream:
        stream.write(written.encode())
    return (path,)


def read_messages(path: Path) -> list[tuple[str, Any]]:
    """Messages of a file, each with its place.

    Raises:
        FileFormatError: It cannot be read, is damaged, or holds none.
    """
    documents = read_documents(path, "a file of messages")
    if len(documents) == 1 and isinstance(documents[0], list):
        documents = documents[0]
    if not documents:
        raise FileFormatError(f"{path} holds no message")
    return [(f"{path}: message {i}", document) for i, document in enumerate(documents)]
