"""Parts of messages as plain data: headers, times, poses, trajectories; and files of messages."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from planner.errors import FileFormatError
from planner.exchange.yaml_text import read_documents, yaml_text
from planner.files import whole_file
from planner.spatial import SE3, FloatArray, pose_to_wxyz

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
