"""Grasps as DexGraspBench reads them: a dictionary in an .npy file each.

    obj_path                   folder with urdf/meshes/*.obj, convex, and info/simplified.json
    obj_scale                  factor on the object's meshes; 1 here
    obj_pose (7,)              frame of the object's file, position (m) and quaternion w, x, y, z
    pregrasp_qpos, grasp_qpos, squeeze_qpos (7 + nq,)   world of the hand's model file as position
                               and quaternion w, x, y, z, then joints in the order of that file

The benchmark commands R qpos to the actuators, R the transmission: it takes them for position
servos. So the squeeze pose is the posture with R q = the commands that make the forces of
``plan_squeeze`` by the hand's own actuator laws, nearest to the grasp.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from planner.batch.dataset import GraspSet
from planner.batch.recipe import with_fingers_of
from planner.contacts import ContactSet
from planner.errors import FileFormatError, PlannerError, TaskError, shown
from planner.exchange.dexgraspbench.hand_file import T_model_base, file_name, write_hand
from planner.exchange.dexgraspbench.object_files import frame_shift, write_object
from planner.exchange.dexgraspbench.squeeze import Squeeze, plan_squeeze, without_servos
from planner.spatial import SE3, FloatArray, pose_from_wxyz, pose_to_wxyz
from planner.task import GraspTask


@dataclass(frozen=True, kw_only=True)
class Exported:
    """Result of an export.

    Attributes:
        hand: Name of the hand for the benchmark.
        written: How many grasps.
        left_out: Reason -> how many grasps were left out for it.
    """

    hand: str
    written: int
    left_out: Mapping[str, int]

    @property
    def summary(self) -> str:
        """One sentence."""
        text = f"{self.written} grasps exported"
        if not self.left_out:
            return text
        reasons = "; ".join(f"{count}: {reason}" for reason, count in self.left_out.items())
        return f"{text}, {sum(self.left_out.values())} left out ({reasons})"


def export_dexgraspbench(
    grasps: GraspSet, folder: Path | str, *, need_all: bool = False
) -> Exported:
    """Write the found grasps of a batch, their objects and their hand.

    In ``folder``, with HAND the name in the result: ``graspdata/HAND/OBJECT/K.npy``,
    ``object/OBJECT/``, ``hand/HAND.yaml`` for the benchmark's ``config/hand`` and ``hand/HAND/``
    with the model and its meshes. Paths in these files are absolute. Several hands may share a
    folder. A grasp that cannot press without gravity is left out.

    Args:
        grasps: The batch.
        folder: Made if it does not exist.
        need_all: Whether a grasp that cannot press is an error instead.

    Raises:
        TaskError: The hand is on an arm, whose way in this format tells differently, or has
            actuators that follow no position; or two objects would have one folder.
        ModelError: The MuJoCo that the benchmark pins cannot read such a hand.
        FileFormatError: The folder cannot be written or holds another hand of that name, or a
            grasp cannot press and all are needed.
    """
    folder = Path(folder).resolve()
    hand = grasps.task(grasps.labels[0]).hand
    if hand.arm is not None:
        raise TaskError(
            f"{hand.name} is on an arm; export for DexGraspBench is for hands alone: plan with "
            "the hand without its arm"
        )
    if reason := without_servos(hand):
        raise TaskError(
            f"{reason}; DexGraspBench commands postures: plan with a hand that has position servos"
        )
    _need_distinct_folders(grasps.labels)
    written = 0
    left_out: Counter[str] = Counter()
    T_base_model = T_model_base(hand).inverse()
    try:
        name = write_hand(hand, folder / "hand")
        for label in grasps.labels:
            task = grasps.task(label)
            place = folder / "object" / file_name(label)
            write_object(task, place)
            target = folder / "graspdata" / name / file_name(label)
            target.mkdir(parents=True, exist_ok=True)
            for old in target.glob("*.npy"):
                old.unlink()  # of an export before
            for _, row in grasps.found(label):
                reason, squeeze = _pressed(task, row)
                if squeeze is None:
                    if need_all:
                        raise FileFormatError(
                            f"grasp {row['k']} of {label!r} cannot press without gravity: "
                            f"{reason}; leave out such grasps, or plan with a smaller grip"
                        )
                    left_out[reason.split(";")[0]] += 1  # the same for many
                    continue
                data: Any = grasp_dict(task, row, place, squeeze, T_base_model)
                np.save(target / f"{row['k']}.npy", data, allow_pickle=True)
                written += 1
    except OSError as error:
        raise FileFormatError(f"cannot write to {folder}: {error.strerror}") from error
    return Exported(hand=name, written=written, left_out=dict(left_out))


def grasp_dict(
    task: GraspTask,
    row: Mapping[str, Any],
    obj_path: Path,
    squeeze: Squeeze,
    T_base_model: SE3,
) -> dict[str, Any]:
    """One grasp in the benchmark's form; see the module.

    The object is where the task has it, but with the table's top at z = 0, where the benchmark
    puts its floor.

    Args:
        task: The task of the row's object.
        row: A row with a grasp.
        obj_path: The object's folder.
        squeeze: Of the grasp.
        T_base_model: World of the hand's model file in the frame of the hand's base.
    """
    lift = SE3(np.eye(3), np.array([0.0, 0.0, -(task.table_height or 0.0)]))
    T_world_object = lift * task.T_world_object
    base = _flat(T_world_object * _base(row) * T_base_model)
    to_file = SE3(np.eye(3), -frame_shift(task.object.shape))
    q, opened = np.array(row["q_rad"]), np.array(row["q_pregrasp_rad"])
    return {
        "obj_path": str(obj_path),
        "obj_scale": 1.0,
        "obj_pose": _flat(T_world_object * to_file),
        "pregrasp_qpos": np.concatenate([base, opened]),
        "grasp_qpos": np.concatenate([base, q]),
        "squeeze_qpos": np.concatenate([base, squeeze.posture(task, q)]),
    }


def row_squeeze(task: GraspTask, row: Mapping[str, Any]) -> Squeeze:
    """The squeeze of a row with a grasp."""
    contacts = ContactSet.from_arrays(
        row["contact_positions_object_m"],
        row["contact_normals_object"],
        mu=task.mu,
        mu_torsion=task.mu_torsion,
        model=task.contact_model,
        fingers=task.finger_names,
    ).transformed(task.T_world_object)
    return plan_squeeze(task, contacts, task.T_world_object * _base(row), np.array(row["q_rad"]))


def _pressed(task: GraspTask, row: Mapping[str, Any]) -> tuple[str, Squeeze | None]:
    """Why a row has no squeeze, "" if it has, and the squeeze; one that fails ends itself alone."""
    try:
        squeeze = row_squeeze(with_fingers_of(task, row), row)
    except PlannerError as error:
        return str(error), None
    return squeeze.reason, None if squeeze.reason else squeeze


def _need_distinct_folders(labels: Sequence[str]) -> None:
    """The grasps of one object would replace those of another."""
    first: dict[str, str] = {}
    for label in labels:
        other = first.setdefault(file_name(label), label)
        if other != label:
            raise TaskError(
                f"the objects {shown(other)} and {label!r} would both be exported as "
                f"{file_name(label)!r}; plan one of them in another batch, or give it another name"
            )


def _base(row: Mapping[str, Any]) -> SE3:
    """Base pose of a row in the object's frame."""
    return pose_from_wxyz(
        np.array(row["base_position_object_m"]), np.array(row["base_quaternion_object_wxyz"])
    )


def _flat(pose: SE3) -> FloatArray:
    """Position (m) and quaternion w, x, y, z in one (7,)."""
    return np.concatenate(pose_to_wxyz(pose))
