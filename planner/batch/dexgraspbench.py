"""Export of a batch to the files that DexGraspBench evaluates.

Read from https://github.com/JYChen18/DexGraspBench at commit 1e7a5a6 (2025-06-05): ``src/task/
eval_func/base.py`` for the keys of a grasp and of an object's ``simplified.json``, ``src/util/
hand_util.py`` for the order of qpos and for how qpos becomes ctrl, ``config/hand`` for the keys of
a hand. A grasp is a dictionary in an .npy file:

    obj_path                   folder with urdf/meshes/*.obj, convex, and info/simplified.json
    obj_scale                  factor on the object's meshes; 1 here
    obj_pose (7,)              object, position (m) and quaternion w, x, y, z
    pregrasp_qpos, grasp_qpos, squeeze_qpos (7 + nq,)   world of the hand's model as position and
                               quaternion w, x, y, z, then joints in the order of the model file

The benchmark commands R qpos to the actuators, R the transmission: it takes them for position
servos. So the squeeze pose is the posture with R q = the commands that make the planned contact
forces by the hand's own actuator laws (``planner.actuation``), nearest to the grasp. Extrapolating
from pre-grasp to grasp would press by an amount that nobody chose. The benchmark has no gravity, so
the forces are planned without it: they only press.
"""

from __future__ import annotations

import json
import os.path
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from planner.batch.dataset import GraspSet
from planner.batch.recipe import with_fingers_of
from planner.contacts import ContactSet
from planner.errors import FileFormatError, TaskError
from planner.files import write_json
from planner.hand import Hand
from planner.judge import plan_forces
from planner.shapes import Shape
from planner.shapes.mesh import Mesh
from planner.shapes.pieces import convex_pieces
from planner.shapes.triangulation import surface_triangles
from planner.spatial import SE3, FloatArray, IntArray, pose_from_wxyz, pose_to_wxyz
from planner.task import GraspTask

__all__ = ["export_dexgraspbench", "grasp_dict", "squeeze_posture"]


def export_dexgraspbench(grasps: GraspSet, folder: Path | str) -> int:
    """Write the found grasps of a batch, their objects and their hand.

    In ``folder``: ``graspdata/OBJECT/K.npy``, ``object/OBJECT/`` and ``hand/`` with the model and a
    file for the benchmark's ``config/hand``. Paths in these files are absolute.

    Args:
        grasps: The batch.
        folder: Made if it does not exist.

    Returns:
        How many grasps were written.

    Raises:
        TaskError: The hand is on an arm, whose way in this format tells differently.
        FileFormatError: The folder cannot be written.
    """
    folder = Path(folder).resolve()
    hand = grasps.task(grasps.labels[0]).hand
    if hand.arm is not None:
        raise TaskError(
            f"{hand.name} is on an arm; export for DexGraspBench is for hands alone: plan with "
            "the hand without its arm"
        )
    written = 0
    try:
        _write_hand(hand, folder / "hand")
        for label in grasps.labels:
            task, name = grasps.task(label), _file_name(label)
            place = folder / "object" / name
            _write_object(task, place)
            target = folder / "graspdata" / name
            target.mkdir(parents=True, exist_ok=True)
            for _, row in grasps.found(label):
                data: Any = grasp_dict(task, row, place)
                np.save(target / f"{row['k']}.npy", data, allow_pickle=True)
                written += 1
    except OSError as error:
        raise FileFormatError(f"cannot write to {folder}: {error.strerror}") from error
    return written


def grasp_dict(task: GraspTask, row: Mapping[str, Any], obj_path: Path) -> dict[str, Any]:
    """One grasp in the benchmark's form; see the module.

    The object is where the task has it, but with the table's top at z = 0, where the benchmark
    puts its floor.

    Args:
        task: The task of the row's object.
        row: A row with a grasp.
        obj_path: The object's folder.
    """
    lift = SE3(np.eye(3), np.array([0.0, 0.0, -(task.table_height or 0.0)]))
    T_world_object = lift * task.T_world_object
    T_object_base = pose_from_wxyz(
        np.array(row["base_position_object_m"]), np.array(row["base_quaternion_object_wxyz"])
    )
    base = _flat(T_world_object * T_object_base)
    q, opened = np.array(row["q_rad"]), np.array(row["q_pregrasp_rad"])
    squeezed = squeeze_posture(task, row)
    return {
        "obj_path": str(obj_path),
        "obj_scale": 1.0,
        "obj_pose": _flat(T_world_object),
        "pregrasp_qpos": np.concatenate([base, opened]),
        "grasp_qpos": np.concatenate([base, q]),
        "squeeze_qpos": np.concatenate([base, squeezed]),
    }


def squeeze_posture(task: GraspTask, row: Mapping[str, Any]) -> FloatArray:
    """Joints (nq,) whose lengths R q are the commands that press with the task's grip.

    Of all such postures the one nearest to the grasp; joints without an actuator stay.

    Raises:
        FileFormatError: No forces press this grasp within the torque limits.
    """
    task = with_fingers_of(task, row)
    floating = replace(task, gravity=np.zeros(3))
    q = np.array(row["q_rad"])
    contacts = ContactSet.from_arrays(
        row["contact_positions_object_m"],
        row["contact_normals_object"],
        mu=task.mu,
        mu_torsion=task.mu_torsion,
        model=task.contact_model,
        fingers=task.finger_names,
    ).transformed(task.T_world_object)
    T_object_base = pose_from_wxyz(
        np.array(row["base_position_object_m"]), np.array(row["base_quaternion_object_wxyz"])
    )
    forces = plan_forces(floating, contacts, task.T_world_object * T_object_base, q)
    if not forces.found:
        raise FileFormatError(
            f"grasp {row['k']} of {row['object']!r} cannot press without gravity: {forces.reason}; "
            "leave it out"
        )
    actuation = task.hand.actuation
    ctrl, _ = actuation.ctrl_for_torque(q, np.zeros_like(q), forces.joint_torques)
    missing = ctrl - actuation.moment @ q
    out: FloatArray = q + np.linalg.pinv(actuation.moment) @ missing
    return out


def _flat(pose: SE3) -> FloatArray:
    """Position (m) and quaternion w, x, y, z in one (7,)."""
    return np.concatenate(pose_to_wxyz(pose))


def _file_name(label: str) -> str:
    """A label as the name of a folder."""
    return re.sub(r"[^\w.\-]", "-", label)


def _write_object(task: GraspTask, folder: Path) -> None:
    """Convex pieces and the file that the density is worked out from."""
    shape = task.object.shape
    (folder / "urdf" / "meshes").mkdir(parents=True, exist_ok=True)
    (folder / "info").mkdir(exist_ok=True)
    for old in (folder / "urdf" / "meshes").glob("convex_piece_*.obj"):
        old.unlink()  # of an export before
    for i, (vertices, faces) in enumerate(_pieces(shape)):
        lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in vertices]
        lines += [f"f {a} {b} {c}" for a, b, c in faces + 1]
        path = folder / "urdf" / "meshes" / f"convex_piece_{i:03d}.obj"
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    info = {
        "gravity_center": [0.0, 0.0, 0.0],
        "obb": (2.0 * shape.half_extents).tolist(),
        "scale": 1.0,
        "density": task.object.mass / shape.volume,
        "mass": task.object.mass,
    }
    write_json(info, folder / "info" / "simplified.json")


def _pieces(shape: Shape) -> list[tuple[FloatArray, IntArray]]:
    """Vertices (n, 3), m, and faces (m, 3) of convex pieces that make up a shape."""
    if not isinstance(shape, Mesh):
        return [surface_triangles(shape)]
    pieces = convex_pieces(shape)
    return list(zip(pieces.vertices, pieces.faces, strict=True))


def _write_hand(hand: Hand, folder: Path) -> None:
    """The hand's model, and what the benchmark's ``config/hand`` says of a hand.

    The file is JSON, which YAML includes.
    """
    folder.mkdir(parents=True, exist_ok=True)
    model = folder / f"{hand.name}.xml"
    model.write_text(hand.new_spec().to_xml(), encoding="utf-8")
    fingers = hand.fingers.values()
    tips = [_body_of(hand, finger.pad.geom) for finger in fingers]
    bodies = [hand.description.palm_body, *(b for finger in fingers for b in sorted(finger.bodies))]
    data = {
        "xml_path": str(model),
        "mocap": True,
        "exclude_table_contact": None,
        "color": [0.2, 0.55, 0.85, 1.0],
        "finger_prefix": [
            os.path.commonprefix(sorted(finger.bodies)) or tip  # noqa: RUF071 - names, not paths
            for finger, tip in zip(fingers, tips, strict=True)
        ],
        "valid_body_name": bodies,
        "tip_body_name": tips,
    }
    text = json.dumps(data, indent=1)
    (folder / f"{hand.name}.yaml").write_text(text + "\n", encoding="utf-8")


def _body_of(hand: Hand, geom: str) -> str:
    """Name of the body that carries a geom."""
    model = hand.mj_model
    return str(model.body(int(model.geom(geom).bodyid[0])).name)
