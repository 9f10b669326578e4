"""Checks of the rows of a dataset as they are read.

Other programs change Parquet files too, and disks lose bits. A damaged file or row becomes one
error here, before anything is computed from it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from planner.batch.rows import arrow
from planner.errors import FileFormatError, shown
from planner.files.data import LARGEST

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


def check_fingers(row: dict[str, Any], names: Sequence[str], *, source: Path | str) -> None:
    """Refuse a row without one contact for each finger of its task, or of those that it names.

    Raises:
        FileFormatError: Contacts and fingers do not match.
    """
    fingers = row.get("fingers") or names
    if len(row["contact_positions_object_m"]) != len(fingers) or not set(fingers) <= set(names):
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
