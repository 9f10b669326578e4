"""Grasps of DexGraspNet: an .npy file per object, a list of dictionaries.

Read from https://github.com/PKU-EPIC/DexGraspNet at commit bdb423c (2024-05-18),
``grasp_generation/main.py`` and ``grasp_generation/tests/visualize_result.py``. Each has

    scale                  factor on the object's mesh
    qpos, qpos_st          the grasp and where its optimisation began, joint or axis -> number:
      WRJTx, WRJTy, WRJTz    origin of the palm in the mesh's frame, m
      WRJRx, WRJRy, WRJRz    angles about the fixed axes x, y, z, in this order, rad
      robot0:FFJ3, ...       joints of the Shadow hand without its wrist, rad, counted from 0

MANO hands have other joints, and are refused by their names.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from planner.errors import FileFormatError
from planner.exchange.array_files import read_array_file
from planner.exchange.formats import (
    GraspFormat,
    ImportedGrasp,
    ImportedGrasps,
    Reading,
    register_format,
)
from planner.exchange.joints import FileJoints
from planner.hands.hand import Hand
from planner.spatial import SE3, FloatArray

NAME = "dexgraspnet"

_PLACE = ("WRJTx", "WRJTy", "WRJTz")
_TURN = ("WRJRx", "WRJRy", "WRJRz")


def read_dexgraspnet(path: Path, hand: Hand, reading: Reading) -> ImportedGrasps:
    """Grasps of a file; poses are of the palm if ``reading`` names no other body.

    Raises:
        FileFormatError: A file of another form, damaged, or with other joints.
    """
    values = _dictionaries(read_array_file(path))
    if values is None:
        raise FileFormatError(
            f"{path} is no list of dictionaries with qpos; it is no file of DexGraspNet: say "
            "which format with --format"
        )
    grasps: list[ImportedGrasp] = []
    joints: FileJoints | None = None
    for i, row in enumerate(values):
        where = f"{path}, grasp {i}"
        qpos = row["qpos"]
        if not isinstance(qpos, dict) or any(name not in qpos for name in (*_PLACE, *_TURN)):
            raise FileFormatError(
                f"{where}: qpos is no dictionary with {', '.join((*_PLACE, *_TURN))}; it is damaged"
            )
        names = [n for n in qpos if n not in (*_PLACE, *_TURN)]
        if joints is None:
            joints = FileJoints(
                hand,
                reading,
                str(path),
                names=names,
                count=len(names),
                base_body=hand.description.palm_body,
            )
            first = names
        if sorted(names) != sorted(first):
            raise FileFormatError(f"{where} names other joints than the grasps before; split it")
        q = joints.of(_numbers(qpos, first, where), where)
        grasps.append(
            ImportedGrasp(
                name=f"grasp {i}",
                T_object_base=joints.base(_pose(qpos, reading.unit or 1.0, where), q),
                q=q,
                object=path.stem,
                scale=float(_numbers(row, ["scale"], where)[0]),
            )
        )
    return ImportedGrasps(
        source=path,
        format=NAME,
        hand="shadow",
        grasps=tuple(grasps),
        assumed=tuple(joints.assumed) if joints else (),
    )


def _dictionaries(data: Any) -> list[Mapping[str, Any]] | None:
    """The grasps of a file, one or many; None for what is none."""
    rows = [data] if isinstance(data, dict) else data
    if isinstance(rows, np.ndarray):
        rows = list(rows) if rows.dtype.hasobject and rows.ndim == 1 else None
    if not isinstance(rows, list) or not rows:
        return None
    return rows if all(isinstance(r, dict) and "qpos" in r for r in rows) else None


def _numbers(values: Mapping[str, Any], names: list[str], where: str) -> FloatArray:
    """Numbers (n,) of a dictionary."""
    try:
        out = np.array([float(values[n]) for n in names])
    except (KeyError, TypeError, ValueError) as error:
        raise FileFormatError(
            f"{where} is damaged: {', '.join(names)} are not all numbers ({error})"
        ) from None
    if not np.isfinite(out).all():
        raise FileFormatError(f"{where} holds numbers that are not finite; leave it out")
    return out


def _pose(qpos: Mapping[str, Any], unit: float, where: str) -> SE3:
    """Pose of the palm in the frame of the object's mesh."""
    x, y, z = _numbers(qpos, list(_TURN), where)
    turn = _about(2, z) @ _about(1, y) @ _about(0, x)
    return SE3(turn, unit * _numbers(qpos, list(_PLACE), where))


def _about(axis: int, angle: float) -> FloatArray:
    """Rotation matrix (3, 3) about a coordinate axis."""
    c, s = np.cos(angle), np.sin(angle)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    out = np.eye(3)
    out[i, i] = out[j, j] = c
    out[i, j], out[j, i] = -s, s
    return out


def _recognises(path: Path) -> bool:
    """Whether it is a list of dictionaries with qpos."""
    if not path.is_file() or path.suffix != ".npy":
        return False
    try:
        return _dictionaries(read_array_file(path)) is not None
    except FileFormatError:
        return False


FORMAT = GraspFormat(
    name=NAME,
    title="DexGraspNet dictionaries (Shadow hand)",
    suffixes=(".npy",),
    loses="",
    recognises=_recognises,
    read=read_dexgraspnet,
)

if __name__ == "__main__":
    register_format(FORMAT)
    print(f"{FORMAT.name}: {FORMAT.title} can be read")
