"""Grasps of DexGraspBench, BODex and Dexonomy: a dictionary in an .npy file each, or many in one.

Read from https://github.com/JYChen18: DexGraspBench at commit 1e7a5a6 (2025-06-05),
``src/task/convert_format.py``; BODex at commit 063a5db (2025-06-05),
``src/curobo/util/save_helper.py`` and ``example_grasp/plan_batch_env.py``; Dexonomy at commit
d561ff9 (2026-03-26), ``dexonomy/op/gen_grasp.py``.

    DexGraspBench   pregrasp_qpos, grasp_qpos, squeeze_qpos (7 + nq,), obj_path, obj_scale, obj_pose
    batched         the same (n, 7 + nq), with scene_path, scene_scale (n,)
    Dexonomy        grasp_qpos (1, 7 + nq), pregrasp_qpos (k, 7 + nq) from the farthest, scene_path
    BODex           robot_pose (1, n, 3, 7 + nq): pre-grasp, grasp, squeeze; joint_names, scene_path

A qpos is position (m), quaternion w, x, y, z and joints; its pose is that of the world of the
hand's model file in the first three, of the URDF's root in BODex's (``--base-body``). A scene file
says where its object is: {"scene": {NAME: {"pose", "scale", "file_path"}}, "task": {"obj_name"}}.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from planner.errors import FileFormatError
from planner.exchange.array_files import read_array_file
from planner.exchange.dexgraspbench.export import write_dexgraspbench
from planner.exchange.dexgraspbench.models import T_model_base
from planner.exchange.formats import (
    GraspFormat,
    ImportedGrasp,
    ImportedGrasps,
    Reading,
    register_format,
)
from planner.exchange.joints import FileJoints, pose_of_seven
from planner.hands.hand import Hand
from planner.spatial import SE3, FloatArray

NAME = "dexgraspbench"


def read_dexgraspbench(path: Path, hand: Hand, reading: Reading) -> ImportedGrasps:
    """Grasps of a file, or of all .npy files in a folder.

    Raises:
        FileFormatError: A file of another form, damaged, with other joints, or without a scene file
            that it needs; or a folder without any.
    """
    files = sorted(path.rglob("*.npy"), key=_in_order) if path.is_dir() else [path]
    grasps: list[ImportedGrasp] = []
    assumed: dict[str, None] = {}
    for file in files:
        data = read_array_file(file)
        if path.is_dir() and not _is_grasp(data):
            continue  # scenes and statistics lie beside the grasps
        if not _is_grasp(data):
            raise FileFormatError(
                f"{file} has neither grasp_qpos nor robot_pose; it is no file of DexGraspBench, "
                "BODex or Dexonomy: say which format with --format"
            )
        label = str(file.relative_to(path)) if path.is_dir() else file.name
        try:
            found, notes = _grasps_of(data, file, label, hand, reading)
        except (TypeError, ValueError, KeyError, IndexError) as error:
            raise FileFormatError(
                f"{file} is damaged or of another version: {type(error).__name__} {error}"
            ) from error
        grasps += found
        assumed.update(dict.fromkeys(notes))
    if not grasps:
        raise FileFormatError(f"{path} holds no grasp of DexGraspBench, BODex or Dexonomy")
    return ImportedGrasps(
        source=path, format=NAME, hand="", grasps=tuple(grasps), assumed=tuple(assumed)
    )


def _in_order(file: Path) -> list[tuple[int, str]]:
    """Key that has 10.npy after 9.npy."""
    return [(int(t), "") if t.isdecimal() else (-1, t) for t in re.split(r"(\d+)", str(file))]


def _is_grasp(data: Any) -> bool:
    return isinstance(data, dict) and ("grasp_qpos" in data or "robot_pose" in data)


def _grasps_of(
    data: Mapping[str, Any], file: Path, label: str, hand: Hand, reading: Reading
) -> tuple[list[ImportedGrasp], list[str]]:
    """Grasps of one file, and what was taken for granted."""
    order = reading.quaternion or "wxyz"
    unit = reading.unit or 1.0
    place, scale, scene = _object_of(data, file, order, unit)
    rows = list(_rows_of(data, file))
    joints = FileJoints(
        hand,
        reading,
        str(file),
        names=None if data.get("joint_names") is None else [str(n) for n in data["joint_names"]],
        count=rows[0][1].shape[-1] - 7 if rows else 0,
    )
    model = SE3.Identity() if joints.body else T_model_base(hand)
    scales = data.get("scene_scale")
    out = []
    for i, (before, at, squeeze) in enumerate(rows):
        where = f"{label}, grasp {i}" if len(rows) > 1 else label
        q = joints.of(at[7:], where)
        body = place.inverse() * _pose(at, order, unit, where) * model
        out.append(
            ImportedGrasp(
                name=where,
                T_object_base=joints.base(body, q),
                q=q,
                q_pregrasp=None if before is None else joints.of(before[7:], where),
                q_squeeze=None if squeeze is None else joints.of(squeeze[7:], where),
                object=scene,
                scale=scale * (1.0 if scales is None else float(np.ravel(scales)[i])),
                T_world_object=place,
            )
        )
    return out, joints.assumed


def _rows_of(
    data: Mapping[str, Any], file: Path
) -> Iterator[tuple[FloatArray | None, FloatArray, FloatArray | None]]:
    """Pre-grasp, grasp and squeeze (7 + nq,) of every grasp of a dictionary."""
    if "robot_pose" in data:
        poses = np.asarray(data["robot_pose"], dtype=float)
        if poses.ndim != 4 or poses.shape[2] != 3:
            raise FileFormatError(
                f"{file}: robot_pose has the shape {poses.shape}, and (1, grasps, 3, 7 + joints) "
                "is read: pre-grasp, grasp and squeeze of a hand without an arm"
            )
        for row in poses.reshape(-1, *poses.shape[2:]):
            yield row[0], row[1], row[2]
        return
    grasp = np.asarray(data["grasp_qpos"], dtype=float)
    if grasp.ndim not in (1, 2) or grasp.shape[-1] < 8:
        raise FileFormatError(
            f"{file}: grasp_qpos has the shape {grasp.shape}; 7 numbers of a pose and the joints "
            "are read, of one grasp or of several"
        )
    grasps = np.atleast_2d(grasp)
    parts: dict[str, FloatArray | None] = {}
    for name in ("pregrasp_qpos", "squeeze_qpos"):
        part = data.get(name)
        rows = None if part is None else np.atleast_2d(np.asarray(part, dtype=float))
        if rows is not None and len(grasps) == 1:
            rows = rows[:1]  # of a way in, the farthest
        if rows is not None and rows.shape != grasps.shape:
            raise FileFormatError(
                f"{file}: {name} has the shape {rows.shape}, grasp_qpos {grasps.shape}; it is "
                "damaged"
            )
        parts[name] = rows
    before, squeeze = parts["pregrasp_qpos"], parts["squeeze_qpos"]
    for i, at in enumerate(grasps):
        yield (
            None if before is None else before[i],
            at,
            None if squeeze is None else squeeze[i],
        )


def _object_of(
    data: Mapping[str, Any], file: Path, order: str, unit: float
) -> tuple[SE3, float, str]:
    """Where the object's frame is, its scale, and its name."""
    if "obj_pose" in data:
        pose, scale = data["obj_pose"], data.get("obj_scale", 1.0)
        name = str(data.get("obj_path", ""))
    elif "scene_path" in data:
        pose, scale, name = _scene_object(data, file)
    else:
        raise FileFormatError(
            f"{file} has neither obj_pose nor scene_path: it does not say where the object is"
        )
    numbers = np.asarray(scale, dtype=float).reshape(-1)
    if not len(numbers) or not np.isfinite(numbers).all() or np.ptp(numbers) > 1e-9:
        raise FileFormatError(
            f"{file}: the object's scale is {scale}; one number for all axes is read"
        )
    return _pose(np.asarray(pose, dtype=float), order, unit, f"{file}, obj_pose"), numbers[0], name


def _scene_object(data: Mapping[str, Any], file: Path) -> tuple[Any, Any, str]:
    """Pose, scale and mesh of the object that a scene file is about."""
    told = data["scene_path"]
    named = str(told if isinstance(told, str) else np.ravel(told)[0])
    tried = (file.parent / named, Path(named))
    found = next((p for p in tried if p.is_file()), None)
    if found is None:
        raise FileFormatError(
            f"{file} says that its object is in the scene file {named}, which is neither beside it "
            "nor in the current folder; copy it there, or start where that path leads to it"
        )
    scene = read_array_file(found)
    try:
        name = scene["task"]["obj_name"]
        item = scene["scene"][name]
        return item["pose"], item["scale"], str(item.get("file_path", name))
    except (TypeError, KeyError, AttributeError) as error:
        raise FileFormatError(
            f"{found} is no scene file of BODex or Dexonomy: it lacks {error}; copy the file again"
        ) from error


def _pose(values: FloatArray, order: str, unit: float, where: str) -> SE3:
    """Pose of the first seven numbers."""
    numbers = np.array(values[:7], dtype=float)
    numbers[:3] *= unit
    return pose_of_seven(numbers, order, where)


def _recognises(path: Path) -> bool:
    """Whether the first file has the keys of a grasp."""
    file = next(iter(sorted(path.rglob("*.npy"))), None) if path.is_dir() else path
    if file is None or file.suffix != ".npy":
        return False
    try:
        return _is_grasp(read_array_file(file))
    except FileFormatError:
        return False


register_format(
    GraspFormat(
        name=NAME,
        title="DexGraspBench, BODex and Dexonomy dictionaries",
        suffixes=(),
        loses=(
            "contacts and forces, friction and gravity, table and obstacles, names of joints, the "
            "way to the pre-grasp"
        ),
        recognises=_recognises,
        read=read_dexgraspbench,
        write=write_dexgraspbench,
    )
)
