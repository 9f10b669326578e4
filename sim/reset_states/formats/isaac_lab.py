"""``isaac_lab``: reset arrays of an in-hand environment of Isaac Lab.

``_reset_idx`` of ``InHandManipulationEnv`` (isaac-sim/IsaacLab, commit 032e26b,
``source/isaaclab_tasks/isaaclab_tasks/direct/inhand_manipulation/inhand_manipulation_env.py``)
writes joint positions and velocities with ``write_joint_state_to_sim``, the same positions as
targets with ``set_joint_position_target``, and the object with ``write_root_pose_to_sim``. An
articulation orders its joints breadth first: match them by name with ``find_joints(names,
preserve_order=True)``. Quaternions are w, x, y, z up to Isaac Lab 2 and x, y, z, w from 3.0 on:
both are here, called so.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from planner.files.whole import whole_file
from sim.reset_states.formats.registry import StateFormat, register_state_format
from sim.reset_states.states import StateSet

ISAAC_FILE = "isaac_lab.npz"
"""Name of the file in the folder of its object and size."""


def _write(states: StateSet, name: str, folder: Path) -> Path:
    path = folder / name / ISAAC_FILE
    arrays = {
        "joint_pos": states.q,
        "joint_vel": np.zeros_like(states.q),
        "joint_pos_target": states.targets,
        "object_pos_b": states.position,
        "object_quat_b_wxyz": states.quaternion,
        "object_quat_b_xyzw": np.roll(states.quaternion, -1, axis=1),
        "object_vel": np.zeros((len(states), 6)),
        "gravity_b": states.gravity,
        "mass": states.mass,
        "friction": states.friction,
    }
    content: dict[str, Any] = {key: value.astype(np.float32) for key, value in arrays.items()}
    with whole_file(path) as stream:
        np.savez(stream, joint_names=np.array(states.joint_names), **content)
    return path


def _read(path: Path) -> Mapping[str, Any]:
    with np.load(path, allow_pickle=False) as file:
        content = {key: file[key] for key in file.files}
    return content | {
        "joint_position": content["joint_pos"],
        "joint_target": content["joint_pos_target"],
        "object_position_m": content["object_pos_b"],
        "object_quaternion_wxyz": content["object_quat_b_wxyz"],
    }


register_state_format(
    StateFormat(
        name="isaac_lab",
        title="joint and root states for Isaac Lab",
        lost="commands of tendons, which become joint targets; digits beyond float32",
        refuses=lambda states: "",
        write=_write,
        read=_read,
    )
)
