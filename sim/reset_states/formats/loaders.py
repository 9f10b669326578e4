"""``hora``: grasp caches of HORA (HaozhiQi/hora, commit 410d958), which start its in-hand turns.

A file is an array (n, 23) of float32: 16 joints, then position (m) and quaternion x, y, z, w of the
object's root. ``hora/tasks/allegro_hand_hora.py`` loads one per entry of ``randomizeScaleList``,
under ``cache/{grasp_cache_name}_grasp_50k_s{scale without its point}.npy``, whatever the number of
rows, and draws rows at random. At a reset it takes the joints as position targets, too.

Joints are in the order in which Isaac Gym walks ``assets/allegro/allegro.urdf``: index, thumb,
middle, ring, as ``_obs_allegro2hora`` of ``hora/algo/deploy/deploy.py`` has it. That URDF and our
allegro_hand have the same joints, limits and base frame. Poses are in the world of HORA, where the
hand stands 0.5 m high, turned by -90 degrees about y after 90 degrees about x: palm up. Its gravity
is -z there, which is -x of the base. Only states that were held within 10 degrees of that are
written.

``isaac_lab``: reset arrays of an in-hand environment of Isaac Lab.

``_reset_idx`` of ``InHandManipulationEnv`` (isaac-sim/IsaacLab, commit 032e26b,
``source/isaaclab_tasks/isaaclab_tasks/direct/inhand_manipulation/inhand_manipulation_env.py``)
writes joint positions and velocities with ``write_joint_state_to_sim``, the same positions as
targets with ``set_joint_position_target``, and the object with ``write_root_pose_to_sim``. An
articulation orders its joints breadth first: match them by name with ``find_joints(names,
preserve_order=True)``. Quaternions are w, x, y, z up to Isaac Lab 2 and x, y, z, w from 3.0 on:
both are here, called so.

``playground``: reset arrays of an environment of MuJoCo Playground (MJX) or any MuJoCo model.

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

from planner.errors import FileFormatError
from planner.files.json_csv import whole_file
from planner.spatial import SE3, FloatArray, pose_from_wxyz, pose_to_wxyz
from sim.reset_states.formats.registry import StateFormat, register_state_format
from sim.reset_states.states import StateSet

_FINGERS = ("index", "thumb", "middle", "ring")

HORA_JOINTS = tuple(f"{finger}_{k}" for finger in _FINGERS for k in range(4))
"""Our names of HORA's joints in its order: joint_0.0 to 3.0, 12.0 to 15.0, 4.0 to 7.0, 8.0 to
11.0."""

T_WORLD_BASE = SE3(
    np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]), np.array([0.0, 0.0, 0.5])
)
"""Pose of the hand's base in HORA's world (``_init_object_pose``)."""

CACHE_NAME = "public_allegro"
"""Its name of the hand of ``assets/allegro/allegro.urdf`` (``PublicAllegroHandHora.yaml``)."""

THRESHOLD = 0.625
"""Height (m) of the object in HORA's world below which an episode of ``public_allegro`` ends
(``reset_height_threshold``)."""

TILT = float(np.deg2rad(10.0))
"""Most that a state's gravity may differ from HORA's, rad."""

DOWN = T_WORLD_BASE.rotation.T @ np.array([0.0, 0.0, -1.0])
"""Direction of HORA's gravity in the hand's base."""

WIDTH = 23


def _upright(states: StateSet) -> Any:
    """Which states (n,) were held under HORA's gravity."""
    along = states.gravity @ DOWN / np.linalg.norm(states.gravity, axis=1)
    return along >= np.cos(TILT)


def _refuses(states: StateSet) -> str:
    if set(states.joint_names) != set(HORA_JOINTS):
        return f"HORA's hand has the 16 joints of allegro_hand, and {states.hand} has others"
    if not _upright(states).any():
        return (
            "no state was held within 10 degrees of HORA's gravity, which points along -x of the "
            "hand's base; give --gravity=-1,0,0"
        )
    return ""


def _write(states: StateSet, name: str, folder: Path) -> Path:
    some = states[_upright(states)]
    poses = [
        T_WORLD_BASE * pose_from_wxyz(p, w)
        for p, w in zip(some.position, some.quaternion, strict=True)
    ]
    placed = np.array([np.concatenate(pose_to_wxyz(pose)) for pose in poses]).reshape(-1, 7)
    rows = np.hstack([some.named(HORA_JOINTS), placed[:, :3], placed[:, 4:], placed[:, 3:4]])
    scale = str(float(states.scale)).replace(".", "")
    # caches of several objects differ in their folder: HORA's name has no place for the object
    path = folder / "hora" / name.rsplit("-s", 1)[0] / f"{CACHE_NAME}_grasp_50k_s{scale}.npy"
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as stream:
        np.save(stream, rows.astype(np.float32))
    return path


def above_threshold(rows: FloatArray) -> float:
    """Share of rows (n, 23) whose object is above HORA's threshold; the others end at once."""
    return float(np.mean(rows[:, 18] > THRESHOLD))


def _read(path: Path) -> Mapping[str, Any]:
    rows = np.load(path, allow_pickle=False)
    if rows.ndim != 2 or rows.shape[1] != WIDTH or rows.dtype != np.float32:
        raise FileFormatError(
            f"{path} is an array of shape {rows.shape} and type {rows.dtype}; HORA's has "
            f"{WIDTH} columns of float32"
        )
    placed = [
        T_WORLD_BASE.inverse() * pose_from_wxyz(row[16:19], row[[22, 19, 20, 21]])
        for row in rows.astype(np.float64)
    ]
    poses = np.array([np.concatenate(pose_to_wxyz(pose)) for pose in placed]).reshape(-1, 7)
    return {
        "joint_names": np.array(HORA_JOINTS),
        "joint_position": rows[:, :16],
        "object_position_m": poses[:, :3],
        "object_quaternion_wxyz": poses[:, 3:],
        "above_threshold": above_threshold(rows),
    }


register_state_format(
    StateFormat(
        name="hora",
        title="HORA's grasp cache",
        lost="joint targets, gravity, mass and friction; states under another gravity than HORA's",
        refuses=_refuses,
        write=_write,
        read=_read,
    )
)


ISAAC_FILE = "isaac_lab.npz"
"""Name of the file in the folder of its object and size."""


def _isaac_lab_write(states: StateSet, name: str, folder: Path) -> Path:
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


def _isaac_lab_read(path: Path) -> Mapping[str, Any]:
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
        write=_isaac_lab_write,
        read=_isaac_lab_read,
    )
)


PLAYGROUND_FILE = "playground.npz"
"""Name of the file in the folder of its object and size."""


def _playground_write(states: StateSet, name: str, folder: Path) -> Path:
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


def _playground_read(path: Path) -> Mapping[str, Any]:
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
        write=_playground_write,
        read=_playground_read,
    )
)
