"""What a row of a LeRobot data set holds: features with their type, shape, names and units.

Frame k pairs what is seen at sample k with the action that leads to sample k + 1: the command in
force when sample k + 1 was taken. So an episode of m samples has m - 1 frames, and the last sample
is the state that the last action leads to.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.episodes.episode import Episode
from sim.episodes.robot import Robot

VIDEO_KEY = "observation.images.front"
"""Key of the film."""

POSE = ["x", "y", "z", "qw", "qx", "qy", "qz"]
POSE_UNITS = ["m", "m", "m", "-", "-", "-", "-"]

INDEX_FEATURES: dict[str, dict[str, Any]] = {
    "timestamp": {"dtype": "float32", "shape": [1], "names": None},
    "frame_index": {"dtype": "int64", "shape": [1], "names": None},
    "episode_index": {"dtype": "int64", "shape": [1], "names": None},
    "index": {"dtype": "int64", "shape": [1], "names": None},
    "task_index": {"dtype": "int64", "shape": [1], "names": None},
}
"""Features that every LeRobot data set has, with the types that it must have them in."""


def features_of(robot: Robot) -> dict[str, dict[str, Any]]:
    """Features of a robot's data set without its film, as ``meta/info.json`` has them.

    Units stand in "info" of a feature, where LeRobot keeps what it does not interpret.
    """
    forces = [f"{name}.{axis}" for name in robot.contact_names for axis in "xyz"]
    touch = list(robot.contact_names)
    return {
        "observation.state": _vector(
            robot.joint_names, robot.joint_units, "joint positions of the hand, and of its arm"
        ),
        "observation.base_pose": _vector(POSE, POSE_UNITS, "pose of the hand's base, world"),
        "observation.object_pose": _vector(POSE, POSE_UNITS, "pose of the object, world"),
        "observation.contact_force": _vector(
            forces, ["N"] * len(forces), "force of each finger on the object, world; 0 off it"
        ),
        "observation.touch": _vector(
            touch, ["-"] * len(touch), "1 where a finger or the palm touches the object, else 0"
        ),
        "action": _vector(
            robot.actuator_names,
            robot.command_units,
            "command of each actuator at the end of the interval that begins with this frame",
        ),
        "next.done": _flag("whether the episode ends with the next state"),
        "next.success": _flag("whether it ends so, and the trial's verdict is success"),
        **INDEX_FEATURES,
    }


def video_feature(size: tuple[int, int], fps: int) -> dict[str, Any]:
    """The feature of the film: width and height in pixels, frames per second."""
    width, height = size
    return {
        "dtype": "video",
        "shape": [height, width, 3],
        "names": ["height", "width", "channels"],
        "info": {
            "video.height": height,
            "video.width": width,
            "video.codec": "h264",
            "video.pix_fmt": "yuv420p",
            "video.fps": fps,
            "video.channels": 3,
            "has_audio": False,
            "is_depth_map": False,
        },
    }


def frames_of(episode: Episode) -> dict[str, NDArray[Any]]:
    """Columns of an episode's frames, (m - 1, ...) each, without the index features.

    Args:
        episode: Its samples are the frames and the state after the last.
    """
    states, count = episode.recording, len(episode) - 1
    touching = np.isfinite(states.points[:, :, 0])
    forces = np.where(touching[..., None], states.forces, 0.0)
    last = np.arange(count) == count - 1
    single = {
        "observation.state": states.q,
        "observation.base_pose": states.T_world_base,
        "observation.object_pose": states.T_world_object,
        "observation.contact_force": forces.reshape(len(states), -1),
        "observation.touch": touching,
    }
    return {
        **{key: values[:count].astype(np.float32) for key, values in single.items()},
        "action": states.commands[1:].astype(np.float32),
        "next.done": last,
        "next.success": last & episode.success,
    }


def _vector(names: Any, units: Any, description: str) -> dict[str, Any]:
    return {
        "dtype": "float32",
        "shape": [len(names)],
        "names": list(names),
        "info": {"units": list(units), "description": description},
    }


def _flag(description: str) -> dict[str, Any]:
    return {"dtype": "bool", "shape": [1], "names": None, "info": {"description": description}}
