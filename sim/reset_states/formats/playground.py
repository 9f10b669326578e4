"""``playground``: reset arrays of an environment of MuJoCo Playground (MJX) or any MuJoCo model.

``reset`` of ``CubeReorient`` (google-deepmind/mujoco_playground, commit d5e6b47,
``_src/manipulation/leap_hand/reorient.py``) makes its data out of qpos (joints of the hand, then
position and quaternion w, x, y, z of the object), qvel and ctrl. These arrays are the same in the
order of the scene's XML file; ``joint_names`` and ``actuator_names`` say by name what stands where,
for ``get_qpos_ids`` of a model with another order.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from planner.files.whole import whole_file
from sim.reset_states.formats.registry import StateFormat, register_state_format
from sim.reset_states.states import StateSet

PLAYGROUND_FILE = "playground.npz"
"""Name of the file in the folder of its object and size."""


def _write(states: StateSet, name: str, folder: Path) -> Path:
    path = folder / name / PLAYGROUND_FILE
    qpos = np.hstack([states.q, states.position, states.quaternion])
    with whole_file(path) as stream:
        np.savez(
            stream,
            joint_names=np.array(states.joint_names),
            actuator_names=np.array(states.actuator_names),
            qpos=qpos.astype(np.float32),
            qvel=np.zeros((len(states), len(states.joint_names) + 6), dtype=np.float32),
            ctrl=states.commands.astype(np.float32),
            gravity=states.gravity.astype(np.float32),
            mass=states.mass.astype(np.float32),
            friction=states.friction.astype(np.float32),
        )
    return path


def _read(path: Path) -> Mapping[str, Any]:
    with np.load(path, allow_pickle=False) as file:
        content = {key: file[key] for key in file.files}
    nq = len(content["joint_names"])
    joints, position, quaternion = np.split(content["qpos"], [nq, nq + 3], axis=1)
    return content | {
        "joint_position": joints,
        "command": content["ctrl"],
        "object_position_m": position,
        "object_quaternion_wxyz": quaternion,
    }


register_state_format(
    StateFormat(
        name="playground",
        title="qpos, qvel, ctrl for MuJoCo Playground",
        lost="digits beyond float32",
        refuses=lambda states: "",
        write=_write,
        read=_read,
    )
)
