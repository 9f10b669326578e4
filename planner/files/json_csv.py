"""JSON files, checked by a schema, and trajectories: every refusal says why and which file."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path
from typing import Any, TypeVar, get_args

import numpy as np
from pydantic import ValidationError

from planner.errors import FileFormatError, shown
from planner.files.whole import whole_file
from planner.plan import JointTrajectory
from planner.schema import StrictData, faults_of
from planner.spatial import pose_to_wxyz

FileT = TypeVar("FileT", bound=StrictData)


def write_json(data: dict[str, Any], path: Path | str) -> None:
    """Write JSON whole or not at all; see ``whole_file``.

    Raises:
        FileFormatError: The folder does not exist or cannot be written.
    """
    text = json.dumps(data, indent=1, allow_nan=False) + "\n"
    with whole_file(Path(path)) as stream:
        stream.write(text.encode())


def write_trajectory(trajectory: JointTrajectory, path: Path | str) -> None:
    """Write a trajectory as CSV: time, phase, one column per joint (rad or m), pose of the base.

    Raises:
        FileFormatError: The folder does not exist or cannot be written.
    """
    base = ["x_m", "y_m", "z_m", "qw", "qx", "qy", "qz"]
    header = ["time_s", "phase", *trajectory.joint_names, *(f"base_{name}" for name in base)]
    rows = [
        [f"{t:.6f}", phase, *(f"{v:.9f}" for v in np.concatenate([q, *pose_to_wxyz(pose)]))]
        for t, phase, q, pose in zip(
            trajectory.times,
            trajectory.phases,
            trajectory.positions,
            trajectory.T_world_base,
            strict=True,
        )
    ]
    text = io.StringIO(newline="")
    csv.writer(text).writerows([header, *rows])
    with whole_file(Path(path)) as stream:
        stream.write(text.getvalue().encode())


def read_json(path: Path | str, what: str) -> dict[str, Any]:
    """Read a JSON object.

    Raises:
        FileFormatError: Missing, unreadable or not a JSON object.
    """
    path = Path(path)
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise FileFormatError(f"cannot read {what} {path}: {error.strerror}") from error
    except (ValueError, RecursionError) as error:  # not JSON, not text, too long or too deep
        raise FileFormatError(f"{path} is damaged or not JSON: {error}") from error
    if not isinstance(data, dict):
        raise FileFormatError(f"{path} holds a {type(data).__name__}; {what} is a JSON object")
    return data


def checked_file(
    schema: type[FileT], data: dict[str, Any], source: str, remedy: str = "plan again"
) -> FileT:
    """Plain data as the file of a schema.

    Args:
        schema: With fields ``format`` ("opposable-KIND"), whose default is what is read, and
            ``version``, a ``Literal`` of those that are.
        data: What the file holds.
        source: What errors call it, as its path.
        remedy: What to do about a file of another version.

    Raises:
        FileFormatError: Another format or version, or damaged.
    """
    wanted = str(schema.model_fields["format"].default)
    versions = get_args(schema.model_fields["version"].annotation)
    kind = wanted.removeprefix("opposable-")
    if data.get("format") != wanted:
        raise FileFormatError(
            f"{source} is not a {kind} file: its format is {shown(data.get('format'))}"
        )
    if data.get("version") not in versions:
        raise FileFormatError(
            f"{source} has {kind} version {shown(data.get('version'))}; this Opposable reads "
            f"version {' or '.join(map(str, versions))}; {remedy}"
        )
    try:
        return schema.model_validate(data)
    except ValidationError as error:
        raise FileFormatError(f"{source} is damaged: {faults_of(error)}") from error
