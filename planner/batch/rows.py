"""Rows of a dataset: their schemas, and the checks of rows that are read.

Rows of a dataset of grasps as plain data, and the Arrow schemas that they follow.

Everything is in the object's frame, whose origin is its centre of mass; the tasks, which say where
the object stands, are kept once per object in the manifest. A row holds what ``GraspSet.plan``
needs to rebuild and verify the plan again, less than a plan file.

Checks of the rows of a dataset as they are read.

Other programs change Parquet files too, and disks lose bits. A damaged file or row becomes one
error here, before anything is computed from it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from planner.errors import FileFormatError, TaskError, shown
from planner.hands.hand import Hand
from planner.plan import GraspPlan
from planner.quality import epsilon_l1, min_weight
from planner.schema import LARGEST
from planner.search.grasp import Attempt
from planner.spatial import pose_to_wxyz
from planner.task import GraspTask

EDGES = 8
"""Edges per friction cone of ``min_weight`` and ``epsilon`` (-)."""


def arrow() -> Any:
    """The module ``pyarrow``.

    Raises:
        TaskError: It is not installed.
    """
    try:
        import pyarrow as pa
        import pyarrow.parquet
    except ImportError as error:
        raise TaskError(
            "datasets of grasps are Parquet files, which need pyarrow; install it with: "
            "pip install 'opposable[batch]'"
        ) from error
    return pa


def failed_row(
    index: int, label: str, k: int, seed: int, reason: str, made: Sequence[Attempt[GraspPlan]]
) -> dict[str, Any]:
    """The row of a request without a grasp; ``reason`` is that of its last attempt."""
    return {
        "index": index,
        "object": label,
        "k": k,
        "seed": seed,
        "found": False,
        "reason": reason,
        "attempts": len(made),
        "cpu_s": sum(a.cpu_s for a in made),
        "tries": [(str(a.failure or ""), a.cpu_s) for a in made],
    }


def found_row(
    index: int, label: str, k: int, plan: GraspPlan, made: Sequence[Attempt[GraspPlan]]
) -> dict[str, Any]:
    """The row of a request with its grasp."""
    task, contacts = plan.task, plan.contacts_in_object
    T_object_world = task.T_world_object.inverse()
    base = pose_to_wxyz(T_object_world * plan.T_world_base)
    start = pose_to_wxyz(T_object_world * plan.T_world_base_start)
    T_object_palm = T_object_world * plan.T_world_palm
    length = task.object.shape.bounding_radius
    row = {
        **failed_row(index, label, k, plan.record.seed, "", made),
        "found": True,
        "fingers": list(task.finger_names),
        "base_position_object_m": base[0].tolist(),
        "base_quaternion_object_wxyz": base[1].tolist(),
        "start_position_object_m": start[0].tolist(),
        "start_quaternion_object_wxyz": start[1].tolist(),
        "approach_object": (T_object_palm.rotation @ task.hand.palm_normal).tolist(),
        "q_rad": plan.q.tolist(),
        "q_pregrasp_rad": plan.q_pregrasp.tolist(),
        "opening_m": plan.pregrasp_distance,
        "contact_positions_object_m": contacts.positions.tolist(),
        "contact_normals_object": contacts.normals.tolist(),
        "contact_forces_object_N": contacts.forces_in_axes().tolist(),
        "contact_torques_normal_N_m": contacts.forces[:, 3].tolist(),
        "joint_torques_N_m": plan.forces.joint_torques.tolist(),
        "min_weight": min_weight(contacts, EDGES),
        "epsilon": epsilon_l1(contacts, length=length, edges=EDGES),
        "largest_pad_gap_m": float(np.abs(plan.verification.pad_gaps).max()),
        "iterations": plan.record.iterations,
        "solver_status": plan.record.status,
        "build_s": plan.record.build_s,
    }
    if plan.arm is not None:
        row["arm_approach_q_rad"] = plan.arm.approach.tolist()
        row["arm_lift_q_rad"] = plan.arm.lift.tolist()
    return row


def attempt_rows(row: dict[str, Any]) -> list[dict[str, Any]]:
    """The rows of the second table: one per attempt of a request."""
    return [
        {"object": row["object"], "k": row["k"], "attempt": i, "reason": reason, "cpu_s": cpu}
        for i, (reason, cpu) in enumerate(row["tries"])
    ]


def grasp_schema(hand: Hand) -> Any:
    """Arrow schema of the table of grasps for a hand; units are in the names.

    The field metadata say what a column is; those of the schema name hand, joints and fingers.
    """
    pa = arrow()
    number, joints = pa.float64(), pa.list_(pa.float64(), hand.nq)
    vector, quaternion = pa.list_(number, 3), pa.list_(number, 4)
    columns = [
        ("object", pa.string(), "what the object is called in the manifest"),
        ("k", pa.int64(), "number of the grasp among those of its object"),
        ("seed", pa.int64(), "seed of the search, as plan_grasp takes it"),
        ("found", pa.bool_(), "whether there is a grasp; the columns after cpu_s are null if not"),
        ("reason", pa.string(), "why not: of the last attempt; empty if found"),
        ("attempts", pa.int64(), "attempts made; the table of attempts has each"),
        ("cpu_s", number, "CPU time of all attempts, without building problems"),
        ("fingers", pa.list_(pa.string()), "that touch: the task's, or fewer if some were spared"),
        ("base_position_object_m", vector, "hand's base at the grasp, object's frame"),
        ("base_quaternion_object_wxyz", quaternion, "w, x, y, z"),
        ("start_position_object_m", vector, "hand's base where the straight approach starts"),
        ("start_quaternion_object_wxyz", quaternion, "w, x, y, z"),
        ("approach_object", vector, "direction that the palm faces, unit, object's frame"),
        ("q_rad", joints, "joints at the grasp (m for slides), order of 'joint_names'"),
        ("q_pregrasp_rad", joints, "joints before the fingers close"),
        ("opening_m", number, "by how much pads are opened in the pre-grasp"),
        ("contact_positions_object_m", pa.list_(vector), "per finger, order of 'fingers'"),
        ("contact_normals_object", pa.list_(vector), "unit, into the object"),
        ("contact_forces_object_N", pa.list_(vector), "planned force on the object, its axes"),
        ("contact_torques_normal_N_m", pa.list_(number), "planned torque about the normal"),
        ("joint_torques_N_m", joints, "torques that make these forces"),
        ("min_weight", number, f"normalised min-weight, {EDGES} edges per cone"),
        ("epsilon", number, f"L1 epsilon, {EDGES} edges, torque / bounding radius"),
        ("largest_pad_gap_m", number, "largest distance of a pad from the true surface"),
        ("iterations", pa.int64(), "evaluations of the residuals in the attempt that succeeded"),
        ("solver_status", pa.string(), "why least squares ended"),
        ("build_s", number, "time for building problems in that worker"),
        ("arm_approach_q_rad", pa.list_(pa.list_(number)), "arm's way in; null without an arm"),
        ("arm_lift_q_rad", pa.list_(pa.list_(number)), "arm's lift; null without an arm"),
    ]
    fields = [pa.field(n, t, metadata={"description": text}) for n, t, text in columns]
    return pa.schema(
        fields,
        metadata={
            "format": "opposable-grasps",
            "hand": hand.name,
            "hand_sha256": hand.digest,
            "joint_names": ",".join(hand.joint_names),
        },
    )


def attempt_schema() -> Any:
    """Arrow schema of the table of attempts."""
    pa = arrow()
    return pa.schema(
        [
            ("object", pa.string()),
            ("k", pa.int64()),
            ("attempt", pa.int64()),
            ("reason", pa.string()),
            ("cpu_s", pa.float64()),
        ]
    )


REMEDY = "; delete that file and go on with the batch, which plans its rows again"


@contextmanager
def reading(path: Path | str) -> Iterator[None]:
    """Errors of Arrow, of the system, and of columns that are missing, as one of ours.

    Raises:
        FileFormatError: The file is damaged.
    """
    try:
        yield
    except (arrow().ArrowException, OSError, KeyError) as error:
        reason = " ".join(str(error).split())
        raise FileFormatError(f"{path} is damaged: {reason}{REMEDY}") from error


def checked_row(
    row: dict[str, Any], nq: int, labels: Collection[str], *, source: Path | str
) -> dict[str, Any]:
    """A row with every column of its kind, and finite numbers.

    Args:
        row: As plain data; see ``rows.grasp_schema``.
        nq: Joints of the hand.
        labels: Objects of the batch.
        source: Where it was read, for the error.

    Raises:
        FileFormatError: A column is missing or unsound.
    """
    wanted = _ALWAYS | (_found(nq) if row.get("found") is True else {})
    for name, fits in wanted.items():
        if name not in row or not fits(row[name]):
            raise FileFormatError(f"{source} is damaged: a row has no sound {name!r}{REMEDY}")
    if row["object"] not in labels:
        raise FileFormatError(
            f"{source} is damaged: the batch has no object {shown(row['object'])}{REMEDY}"
        )
    if row["found"]:
        n = len(row["contact_positions_object_m"])
        same = ("contact_normals_object", "contact_forces_object_N", "contact_torques_normal_N_m")
        if n == 0 or any(len(row[name]) != n for name in same):
            raise FileFormatError(f"{source} is damaged: contacts of a row do not match{REMEDY}")
    return row


def check_fingers(row: dict[str, Any], task: GraspTask, *, source: Path | str) -> None:
    """Refuse a row without one contact for each finger of its task, or of those that it names.

    Raises:
        FileFormatError: Contacts and fingers do not match.
    """
    names = task.finger_names
    fingers = row.get("fingers") or names
    known = set(task.all_names)
    if len(row["contact_positions_object_m"]) != len(fingers) or not set(fingers) <= known:
        raise FileFormatError(
            f"{source} is damaged: a row's contacts are not those of {', '.join(names)}{REMEDY}"
        )


def _is_number(value: Any) -> bool:
    return isinstance(value, float | int) and math.isfinite(value) and abs(value) <= LARGEST


def _is_count(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= 0


def _is_text(value: Any) -> bool:
    return isinstance(value, str)


def _numbers(length: int | None = None) -> Callable[[Any], bool]:
    """So many numbers, or any number of them."""

    def fits(value: Any) -> bool:
        listed = isinstance(value, list) and (length is None or len(value) == length)
        return listed and all(map(_is_number, value))

    return fits


def _vectors(value: Any) -> bool:
    return isinstance(value, list) and all(map(_numbers(3), value))


def _quaternion(value: Any) -> bool:
    return _numbers(4)(value) and math.hypot(*value) > 0.5


def _paths(value: Any) -> bool:
    """Rows of numbers of one length, or none at all."""
    if value is None:
        return True
    rows: Sequence[Any] = value if isinstance(value, list) else [None]
    return all(map(_numbers(), rows)) and len({len(row) for row in rows}) <= 1


_ALWAYS: dict[str, Callable[[Any], bool]] = {
    "object": _is_text,
    "k": _is_count,
    "seed": _is_count,
    "found": lambda value: isinstance(value, bool),
    "reason": _is_text,
    "attempts": _is_count,
    "cpu_s": _is_number,
}


def _found(nq: int) -> dict[str, Callable[[Any], bool]]:
    """Further columns of a row with a grasp."""
    poses = {f"{name}_position_object_m": _numbers(3) for name in ("base", "start")}
    turns = {f"{name}_quaternion_object_wxyz": _quaternion for name in ("base", "start")}
    joints = {name: _numbers(nq) for name in ("q_rad", "q_pregrasp_rad", "joint_torques_N_m")}
    contacts = ("contact_positions_object_m", "contact_normals_object", "contact_forces_object_N")
    numbers = ("opening_m", "min_weight", "epsilon", "largest_pad_gap_m", "build_s")
    return {
        **poses,
        **turns,
        **joints,
        **dict.fromkeys(contacts, _vectors),
        **dict.fromkeys(numbers, _is_number),
        "approach_object": _numbers(3),
        "contact_torques_normal_N_m": _numbers(),
        "iterations": _is_count,
        "solver_status": _is_text,
        "arm_approach_q_rad": _paths,
        "arm_lift_q_rad": _paths,
    }
