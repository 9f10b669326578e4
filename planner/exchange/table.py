"""``table``: grasps as a plain table of poses and joints by names with units, read and written.

``planner.exchange.table_forms`` has the schema and its three forms.
"""

from __future__ import annotations

import json
import zipfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from planner.errors import FileFormatError, TaskError
from planner.exchange.formats import (
    GraspFormat,
    ImportedGrasp,
    ImportedGrasps,
    Reading,
    Writing,
    register_format,
)
from planner.exchange.joints import FileJoints, T_file_object, T_object_body, pose_of_seven
from planner.exchange.table_forms import (
    ANGLES,
    LENGTHS,
    TABLE_FORMS,
    TableFile,
    TableGrasp,
    read_table_file,
    table_bytes,
)
from planner.files import whole_file
from planner.hands.hand import Hand
from planner.plan import GraspPlan
from planner.spatial import SE3, pose_to_wxyz

NAME = "table"

HEAD = 4096
"""Bytes of a file by which it is recognised."""


def read_table(path: Path, hand: Hand, reading: Reading) -> ImportedGrasps:
    """Grasps of a table.

    Raises:
        FileFormatError: Damaged, of another version, for another hand, or with other joints.
    """
    table = read_table_file(path)
    if table.hand and table.hand != hand.name:
        raise FileFormatError(
            f"{path} is for the hand {table.hand!r}, and {hand.name!r} is given; leave --hand out "
            "to take that of the file, or correct the file"
        )
    joints = FileJoints(
        hand,
        reading,
        str(path),
        names=table.joint_names,
        count=len(table.joint_names),
        base_body=table.base_body,
    )
    order, unit = reading.quaternion or "wxyz", reading.unit or LENGTHS[table.length]
    slide = np.array([_slides(hand, name) for name in hand.joint_names])
    units = np.where(slide, unit, ANGLES[table.angle])
    told = joints.of(np.array([n in table.slides for n in table.joint_names], dtype=float))
    if ((told > 0) != slide).any():
        wrong = ", ".join(np.array(hand.joint_names)[(told > 0) != slide])
        raise FileFormatError(
            f"{path} gives {wrong} as {'an angle' if slide.any() else 'a length'}, and in "
            f"{hand.name} it is not; give lengths for joints that slide, angles for the others"
        )
    grasps = []
    for i, row in enumerate(table.grasps):
        where = f"{path}, grasp {i}"
        body = _pose(row.position, row.quaternion_wxyz, unit, order, where)
        q = units * joints.of(np.array(row.joints), where)
        opened, pressed = (
            None if v is None else units * joints.of(np.array(v), where)
            for v in (row.pregrasp_joints, row.squeeze_joints)
        )
        place = None
        if row.object_position is not None and row.object_quaternion_wxyz is not None:
            place = _pose(row.object_position, row.object_quaternion_wxyz, unit, order, where)
        grasps.append(
            ImportedGrasp(
                name=row.name or f"row {i}",
                T_object_base=joints.base(body, q),
                q=q,
                q_pregrasp=opened,
                q_squeeze=pressed,
                object=row.object,
                scale=row.scale,
                T_world_object=place,
                confidence=row.confidence,
            )
        )
    return ImportedGrasps(
        source=path,
        format=NAME,
        hand=table.hand,
        grasps=tuple(grasps),
        assumed=tuple(joints.assumed),
    )


def table_of(plans: Sequence[GraspPlan], writing: Writing | None = None) -> TableFile:
    """Plans of one hand as a table.

    Raises:
        TaskError: There is none, or they are of several hands.
        NotFoundError: The hand has no such body.
    """
    writing = writing or Writing()
    if len({plan.task.hand.digest for plan in plans}) != 1:
        raise TaskError("a table is for one hand; give plans of one, a table for each hand")
    hand = plans[0].task.hand
    rows = []
    for plan in plans:
        position, turn = pose_to_wxyz(T_object_body(plan, writing.base_body))
        place = plan.task.T_world_object * T_file_object(plan.task).inverse()
        where, upright = pose_to_wxyz(place)
        rows.append(
            TableGrasp(
                name=f"seed {plan.record.seed}",
                position=tuple(position.tolist()),
                quaternion_wxyz=tuple(turn.tolist()),
                joints=tuple(plan.q.tolist()),
                pregrasp_joints=tuple(plan.q_pregrasp.tolist()),
                object=plan.task.object.shape.spec,
                object_position=tuple(where.tolist()),
                object_quaternion_wxyz=tuple(upright.tolist()),
            )
        )
    names = tuple(writing.rename.get(n, n) for n in hand.joint_names)
    return TableFile(
        hand=hand.name,
        base_body=writing.base_body,
        joint_names=names,
        slides=tuple(
            told for told, n in zip(names, hand.joint_names, strict=True) if _slides(hand, n)
        ),
        grasps=tuple(rows),
    )


def write_table(plans: Sequence[GraspPlan], path: Path, writing: Writing) -> tuple[Path, ...]:
    """Write plans as a table, in the form of its suffix, whole or not at all.

    Raises:
        TaskError: There are no plans, they are of several hands, or another suffix.
        FileFormatError: The folder does not exist or cannot be written.
    """
    data = table_bytes(table_of(plans, writing), path.suffix)
    with whole_file(path) as stream:
        stream.write(data)
    return (path,)


def _pose(
    position: tuple[float, ...], turn: tuple[float, ...], unit: float, order: str, where: str
) -> SE3:
    return pose_of_seven(np.array([*(unit * p for p in position), *turn]), order, where)


def _slides(hand: Hand, joint: str) -> bool:
    """Whether a joint of a hand slides."""
    return int(hand.mj_model.joint(joint).type[0]) == SLIDE


SLIDE = 2
"""``mujoco.mjtJoint.mjJNT_SLIDE``."""


def _recognises(path: Path) -> bool:
    """Whether it says so; a CSV is of no other format."""
    if not path.is_file() or path.suffix not in TABLE_FORMS:
        return False
    if path.suffix == ".csv":
        return True
    if path.suffix == ".npz":
        try:
            with zipfile.ZipFile(path) as packed:
                return {"joint_names.npy", "quaternion_wxyz.npy"} <= set(packed.namelist())
        except (zipfile.BadZipFile, OSError):
            return False
    with path.open("rb") as stream:
        head = stream.read(HEAD)
    return json.dumps("opposable-grasp-table").encode() in head


register_format(
    GraspFormat(
        name=NAME,
        title="a plain table of poses and joints by names with units: CSV, JSON or NPZ",
        suffixes=(".csv", ".json", ".npz"),
        loses=(
            "the object's mass, contacts and forces, friction, table and obstacles, the way to the "
            "pre-grasp"
        ),
        recognises=_recognises,
        read=read_table,
        write=write_table,
        heeds=frozenset({"rename", "base_body"}),
        hand_of=lambda path: read_table_file(path).hand,
        object_specs=True,
    )
)
