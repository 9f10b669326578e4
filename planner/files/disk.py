"""What touches the disk: JSON by a schema, files written whole, journals, folders of plans.

JSON files, checked by a schema, and trajectories: every refusal says why and which file.

Files that are written whole or not at all, and names that stay in their folder.

Plan files of a folder, as ``opposable refine`` writes one, without reading them whole.

``opposable refine``, ``export``, ``dataset`` and ``test`` take such a folder for its
files.
"""

from __future__ import annotations

import csv
import io
import json
import os
import re
import secrets
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO, Self, TypeVar, get_args

import numpy as np
from pydantic import ValidationError

from planner.errors import FileFormatError, shown
from planner.plan import JointTrajectory
from planner.schema import StrictData, faults_of
from planner.spatial import pose_to_wxyz

LONGEST_NAME = 100
"""Characters of a name in a file's name: file systems end at 255 bytes."""

PART = re.compile(r"\.[0-9a-f]{16}\.part")
"""Name of a file that is being written, or was when its process was killed."""

HANDOVER_FORMAT = "opposable-handover"
"""Older format of movements in which one hand gives the object to another."""

MOVEMENT_FORMATS = (
    "opposable-movement",
    "opposable-motion",
    "opposable-gait",
    "opposable-manipulation",
    HANDOVER_FORMAT,
)
"""Formats of plans that are movements; all but the first are older and read only."""


@contextmanager
def whole_file(path: Path) -> Iterator[BinaryIO]:
    """A stream whose content becomes the file, if the block ends without an error.

    Until then it is a new file beside it, of a random name. Links are not followed; a file or link
    at ``path`` is replaced.

    Raises:
        FileFormatError: The folder does not exist or cannot be written, or a folder is in the way.
    """
    partial = path.with_name(f".{secrets.token_hex(8)}.part")
    try:
        with partial.open("xb") as stream:
            yield stream
        os.replace(partial, path)
    except OSError as error:
        raise FileFormatError(f"cannot write {path}: {error.strerror or error}") from error
    except ValueError as error:  # a null character in the name
        raise FileFormatError(f"cannot write {str(path)!r}: {error}") from error
    finally:
        with suppress(OSError, ValueError):
            partial.unlink()


def plain_name(text: str) -> str:
    """A name of a hand or an object as part of a file's name: no folders, nothing hidden.

    Letters, digits, and ``_ . + -`` stay; everything else becomes a dash.
    """
    plain = re.sub(r"[^\w.+\-]", "-", text)[:LONGEST_NAME].lstrip(".-")
    return plain or "unnamed"


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


class Journal:
    """A file of JSON objects, one a line, that grows: a row is on disk once ``add`` returns.

    Use it as a context, or close it. ``read_json_lines`` reads it again after any interruption.
    """

    def __init__(self, path: Path, *, anew: bool = False) -> None:
        """Open it at its end; ``anew`` without the rows that it has.

        Raises:
            FileFormatError: It cannot be written, or its folder does not exist.
        """
        try:
            self._stream = path.open("w" if anew else "a", encoding="utf-8")
            if self._stream.tell():
                self._stream.write("\n")  # after half a line, if a kill left one
        except OSError as error:
            raise FileFormatError(f"cannot write {path}: {error.strerror}") from error

    def __enter__(self) -> Self:
        """The journal itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close it."""
        self.close()

    def add(self, row: Mapping[str, Any]) -> None:
        """Add a row."""
        self._stream.write(json.dumps(row) + "\n")
        self._stream.flush()

    def close(self) -> None:
        """Let go of the file."""
        self._stream.close()


def read_json_lines(path: Path) -> Iterator[dict[str, Any]]:
    """Objects of a journal, one a line; half a line, left by a kill, is skipped."""
    if path.exists():
        for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
            with suppress(ValueError):
                row = json.loads(line)
                if isinstance(row, dict):
                    yield row


MOST_DIFFERENCES = 4
"""Most differences between two requests in one message."""


def refuse_other_request(
    folder: Path, what: str, there: dict[str, Any], asked: dict[str, Any]
) -> None:
    """Refuse to go on in a folder that was begun with another request.

    Args:
        folder: The folder.
        what: What it holds, such as "batch".
        there: The request that it was begun with, plain data.
        asked: That of now.

    Raises:
        FileFormatError: They differ; lists the differences.
    """
    found = list(_differences("", there, json.loads(json.dumps(asked))))
    if found:
        more = len(found) - MOST_DIFFERENCES
        raise FileFormatError(
            f"{folder} holds another {what}: {'; '.join(found[:MOST_DIFFERENCES])}"
            + (f"; and {more} more" if more > 0 else "")
            + ". Ask for the same to go on with it, or name another folder"
        )


def _differences(where: str, there: Any, asked: Any) -> Iterator[str]:
    """Sentences about the differences of two values of plain data."""
    if isinstance(there, dict) and isinstance(asked, dict):
        for key in dict.fromkeys((*there, *asked)):
            inner = f"{where}.{key}" if where else str(key)
            yield from _differences(inner, there.get(key), asked.get(key))
    elif isinstance(there, list) and isinstance(asked, list) and len(there) == len(asked):
        for i, (a, b) in enumerate(zip(there, asked, strict=True)):
            yield from _differences(f"{where}[{i}]", a, b)
    elif there != asked:
        yield f"{where} is {_short(there)} there and {_short(asked)} here"


def _short(value: Any) -> str:
    return f"{len(value)} values" if isinstance(value, list) else shown(value)


HEAD = 4096
"""Bytes of a file within which it says its format."""

_FORMAT = re.compile(rb'"format"\s*:\s*"(opposable-[a-z-]+)"')


def format_told(file: Path) -> str:
    """The format that a JSON file of ours says of itself, "" for every other file or folder.

    Raises:
        FileFormatError: It cannot be read.
    """
    if not file.is_file():
        return ""
    try:
        with file.open("rb") as stream:
            head = stream.read(HEAD)
    except OSError as error:
        raise FileFormatError(f"cannot read {file}: {error.strerror}") from error
    told = _FORMAT.search(head) if head.lstrip().startswith(b"{") else None
    return told[1].decode() if told else ""


def plan_files(folder: Path, formats: Collection[str] = ("opposable-plan",)) -> tuple[Path, ...]:
    """JSON files of some formats that lie in a folder, by name.

    Args:
        folder: The folder; folders in it are not looked at.
        formats: What the files say of themselves.

    Raises:
        FileFormatError: The folder or a file cannot be read.
    """
    try:
        files = sorted(folder.iterdir())
    except OSError as error:
        raise FileFormatError(f"cannot read the folder {folder}: {error.strerror}") from error
    return tuple(f for f in files if f.suffix == ".json" and format_told(f) in formats)
