"""Results of FRoGGeR's timing script: a pickle per object and robot.

Read from https://github.com/alberthli/frogger at commit f91157f (2024-05-25): its files
``data/OBJECT/exp_OBJECT_ROBOT_*.pkl``, of which the package itself has no reader. They have

    q_stars (n, nq)        joints of the grasps in the order of Drake's plant; NaN where none was
                           found. A robot without an arm has quaternion w, x, y, z and position (m)
                           of its base first
    obj_settings           {"X_WO": pose of the mesh's frame in the world, "name", ...}
    model_settings         {"name": the robot, "mu", ...}

No joint is named: say ``--by-number`` or ``--joint-names``. An arm stands at the world's origin.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from planner.errors import FileFormatError
from planner.exchange.array_files import read_array_file, read_pickle
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

NAME = "frogger"


def read_frogger(path: Path, hand: Hand, reading: Reading) -> ImportedGrasps:
    """Grasps of a file; those that FRoGGeR did not find are left out.

    Raises:
        FileFormatError: A file of another form, damaged, or with other joints.
    """
    data = read_pickle(path)
    if not _is_result(data):
        raise FileFormatError(
            f"{path} has no q_stars with obj_settings; it is no result of FRoGGeR: say which "
            "format with --format"
        )
    try:
        stars = np.asarray(data["q_stars"], dtype=float)
        place = np.asarray(data["obj_settings"]["X_WO"], dtype=float)
        name = str(data["obj_settings"].get("name", ""))
        robot = str(data.get("model_settings", {}).get("name", ""))
    except (TypeError, KeyError, ValueError, AttributeError) as error:
        raise FileFormatError(f"{path} is damaged or of another version: {error}") from error
    if stars.ndim != 2 or place.shape != (3, 4):
        raise FileFormatError(
            f"{path}: q_stars has the shape {stars.shape} and X_WO {place.shape}; (grasps, joints) "
            "and (3, 4) are read"
        )
    T_world_object = SE3(place[:, :3], place[:, 3])
    floats = hand.arm is None
    joints = FileJoints(hand, reading, str(path), count=stars.shape[1] - (7 if floats else 0))
    grasps = []
    for i, row in enumerate(stars):
        if not np.isfinite(row).all():
            continue
        where = f"{path}, q_stars row {i}"
        q = joints.of(row[7:] if floats else row, where)
        body = _floating(row, reading, where) if floats else SE3.Identity()
        grasps.append(
            ImportedGrasp(
                name=f"row {i}",
                T_object_base=joints.base(T_world_object.inverse() * body, q),
                q=q,
                object=name,
                T_world_object=T_world_object,
            )
        )
    if not grasps:
        raise FileFormatError(f"{path} holds no grasp: no row of q_stars is finite")
    return ImportedGrasps(
        source=path, format=NAME, hand=robot, grasps=tuple(grasps), assumed=tuple(joints.assumed)
    )


def _floating(row: FloatArray, reading: Reading, where: str) -> SE3:
    """Pose of a robot without an arm: quaternion first, then position."""
    position = (reading.unit or 1.0) * row[4:7]
    return pose_of_seven(np.concatenate([position, row[:4]]), reading.quaternion or "wxyz", where)


def _is_result(data: Any) -> bool:
    return isinstance(data, dict) and {"q_stars", "obj_settings"} <= set(data)


def _recognises(path: Path) -> bool:
    """Whether a pickle has the keys."""
    if not path.is_file() or path.suffix not in (".pkl", ".pickle"):
        return False
    try:
        return _is_result(read_array_file(path))
    except FileFormatError:
        return False


FORMAT = GraspFormat(
    name=NAME,
    title="results of FRoGGeR's timing script",
    suffixes=(".pkl", ".pickle"),
    loses="",
    recognises=_recognises,
    read=read_frogger,
)

if __name__ == "__main__":
    register_format(FORMAT)
    print(f"{FORMAT.name}: {FORMAT.title} can be read")
