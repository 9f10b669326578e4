"""Schema of ``table``: poses and joints by names with units, the easy door for every other tool.

One content in three forms:

    .json   this schema, grasp by grasp
    .npz    arrays of the same names, one row per grasp; "" or NaN for what a grasp lacks
    .csv    one row per grasp; units are part of the names of columns

Poses are of ``base_body`` of the hand in the frame of the object's own file; quaternions are
w, x, y, z.

Columns of CSV, of which those in brackets may be left out or empty:

    [name] [hand] [base_body] [object] [scale] [confidence]
    x_m y_m z_m, or x_mm y_mm z_mm       position of the hand's body in the object's frame
    qw qx qy qz                          its orientation
    JOINT_rad, JOINT_deg, JOINT_m or JOINT_mm; [pregrasp:JOINT_...] [squeeze:JOINT_...]
    [object_x_m object_y_m object_z_m object_qw object_qx object_qy object_qz]
"""

from __future__ import annotations

import csv
import io
import json
import math
import zipfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from planner.errors import FileFormatError, TaskError, few_of
from planner.exchange.array_files import read_npz
from planner.files import read_json
from planner.files.disk import checked_file
from planner.schema import StrictData

LENGTHS = {"m": 1.0, "mm": 1e-3}
"""Unit of lengths and of slides -> metres."""


ANGLES = {"rad": 1.0, "deg": 0.017453292519943295}
"""Unit of hinges -> radians."""


PARTS = ("joints", "pregrasp_joints", "squeeze_joints")
"""Fields that hold a number per joint."""


Position = Annotated[tuple[float, float, float], "position"]


Quaternion = Annotated[tuple[float, float, float, float], "quaternion"]


class TableGrasp(StrictData):
    """One grasp.

    Attributes:
        name: What to call it; its row if empty.
        position: Of the hand's body in the object's frame, in the file's unit.
        quaternion_wxyz: Its orientation.
        joints: At the grasp, in the order of ``TableFile.joint_names``.
        pregrasp_joints: Before it.
        squeeze_joints: Commanded to press.
        object: The object's name or path.
        scale: Factor on the object's mesh.
        object_position: Of the object's frame in the world.
        object_quaternion_wxyz: Its orientation.
        confidence: Of whoever made it.
    """

    name: str = ""
    position: Position
    quaternion_wxyz: Quaternion
    joints: tuple[float, ...]
    pregrasp_joints: tuple[float, ...] | None = None
    squeeze_joints: tuple[float, ...] | None = None
    object: str = ""
    scale: Annotated[float, Field(gt=0.0)] = 1.0
    object_position: Position | None = None
    object_quaternion_wxyz: Quaternion | None = None
    confidence: float | None = None


class TableFile(StrictData):
    """A file of grasps.

    Attributes:
        format: What it is.
        version: Of this schema.
        hand: Name of the hand; "" for any.
        base_body: Body whose pose is told; "" for the hand's base.
        length: Unit of positions, and of joints that slide.
        angle: Unit of joints that turn.
        joint_names: Order of the joints.
        slides: Those of them that slide, in the unit of lengths; the others turn.
        grasps: The grasps.
    """

    format: Literal["opposable-grasp-table"] = "opposable-grasp-table"
    version: Literal[1] = 1
    hand: str = ""
    base_body: str = ""
    length: Literal["m", "mm"] = "m"
    angle: Literal["rad", "deg"] = "rad"
    joint_names: tuple[str, ...]
    slides: tuple[str, ...] = ()
    grasps: tuple[TableGrasp, ...]

    @model_validator(mode="after")
    def _same_number(self) -> Self:
        """As many joints as names; whole poses."""
        for i, grasp in enumerate(self.grasps):
            for part in PARTS:
                values = getattr(grasp, part)
                if values is not None and len(values) != len(self.joint_names):
                    raise ValueError(
                        f"grasps.{i}.{part} has {len(values)} numbers for "
                        f"{len(self.joint_names)} joint names"
                    )
            if (grasp.object_position is None) != (grasp.object_quaternion_wxyz is None):
                raise ValueError(f"grasps.{i} has half a pose of the object")
        return self


_PREFIXES = dict(zip(PARTS, ("", "pregrasp:", "squeeze:"), strict=True))
_TEXTS = ("name", "object")
_VECTORS = {"position": 3, "quaternion_wxyz": 4, "object_position": 3, "object_quaternion_wxyz": 4}
_NEEDED = ("position", "quaternion_wxyz", "joints")
_AXES = ("x", "y", "z")
_QUATERNION = ("qw", "qx", "qy", "qz")
_HEADER = ("format", "version", "hand", "base_body", "length", "angle", "joint_names", "slides")


def read_table_file(path: Path) -> TableFile:
    """The content of a table in any of its forms, checked.

    Raises:
        FileFormatError: Damaged, of another version, or none of ``TABLE_FORMS``.
    """
    if path.suffix not in TABLE_FORMS:
        raise FileFormatError(f"{path} is no table of grasps; give {', '.join(TABLE_FORMS)}")
    data = TABLE_FORMS[path.suffix][0](path)
    if path.suffix != ".csv":  # there it was seen to by row and column
        _need_finite(data, str(path))
    return checked_file(TableFile, data, str(path), "write it again in that version")


def table_bytes(table: TableFile, suffix: str) -> bytes:
    """The content of a file of the suffix ".json", ".npz" or ".csv".

    Raises:
        TaskError: Another suffix.
    """
    if suffix not in TABLE_FORMS:
        raise TaskError(f"a table ends with {', '.join(TABLE_FORMS)}, not {suffix!r}; name it so")
    return TABLE_FORMS[suffix][1](table)


def _from_json(path: Path) -> dict[str, Any]:
    return read_json(path, "a table of grasps")


def _need_finite(data: Mapping[str, Any], where: str) -> None:
    """Refuse NaN and infinity with the grasp and the joint or axis that they are of.

    Raises:
        FileFormatError: There is one.
    """
    grasps, joints = data.get("grasps"), data.get("joint_names")
    for i, grasp in enumerate(grasps if isinstance(grasps, list) else ()):
        for name, value in grasp.items() if isinstance(grasp, dict) else ():
            for k, number in enumerate(value if isinstance(value, list) else [value]):
                if not isinstance(number, float) or math.isfinite(number):
                    continue
                part = f"[{k}]" if isinstance(value, list) else ""
                if name in PARTS and isinstance(joints, list) and k < len(joints):
                    part = f" of {joints[k]}"
                raise FileFormatError(
                    f"{where}, grasp {i}, {name}{part}: {number} {MEND.format('grasp')}"
                )


MEND = "is no number; put a finite one there, or leave the {} out"
"""What to do about a cell that holds NaN, infinity, text or nothing."""


def _to_json(table: TableFile) -> bytes:
    return (json.dumps(table.model_dump(exclude_none=True), indent=1) + "\n").encode()


def _from_npz(path: Path) -> dict[str, Any]:
    """Arrays as rows; a NaN or an empty text is what a grasp lacks."""
    arrays = read_npz(path)
    data: dict[str, Any] = {n: arrays[n].tolist() for n in _HEADER if n in arrays}
    columns = {n: a for n, a in arrays.items() if n not in _HEADER}
    count = {len(a) if a.ndim else -1 for a in columns.values()}
    if len(count) != 1 or -1 in count:
        raise FileFormatError(
            f"{path} is damaged: its arrays have different lengths, "
            f"{ {n: list(a.shape) for n, a in columns.items()} }; one row per grasp is needed"
        )
    values = {n: a.tolist() for n, a in columns.items()}
    data["grasps"] = [
        {n: v[i] for n, v in values.items() if n in _NEEDED or _is_there(v[i])}
        for i in range(count.pop())
    ]
    return data


def _to_npz(table: TableFile) -> bytes:
    rows = [g.model_dump() for g in table.grasps]
    arrays = {n: np.array(v) for n, v in table.model_dump(exclude={"grasps"}).items()}
    widths = {**_VECTORS, **dict.fromkeys(PARTS, len(table.joint_names))}
    for name in rows[0] if rows else ():
        column = [row[name] for row in rows]
        if all(v is None for v in column):
            continue
        if name in _TEXTS:
            arrays[name] = np.array(column)
        else:
            lack = [float("nan")] * widths[name] if name in widths else float("nan")
            arrays[name] = np.array([lack if v is None else v for v in column], dtype=float)
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as packed:
        for name, array in arrays.items():
            member = io.BytesIO()
            np.lib.format.write_array(member, array, allow_pickle=False)
            shaped = zipfile.ZipInfo(f"{name}.npy")  # without the time of day
            packed.writestr(shaped, member.getvalue(), zipfile.ZIP_DEFLATED)
    return stream.getvalue()


def _is_there(value: Any) -> bool:
    if isinstance(value, list):
        return not (value and all(isinstance(v, float) and v != v for v in value))
    return bool(value != "" and value == value)


def _from_csv(path: Path) -> dict[str, Any]:
    """Rows of text as a table; units are read from the names of columns."""
    try:
        lines = list(csv.reader(io.StringIO(path.read_text(encoding="utf-8-sig"), newline="")))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise FileFormatError(f"{path} cannot be read as CSV: {error}") from None
    if not lines:
        raise FileFormatError(f"{path} is empty; a table begins with the names of its columns")
    header = [h.strip() for h in lines[0]]
    rows = {i: [c.strip() for c in row] for i, row in enumerate(lines[1:], start=2) if any(row)}
    if len(header) == 1 and (other := next((c for c in ";\t" if c in header[0]), "")):
        raise FileFormatError(
            f"{path} has {'tabs' if other == chr(9) else 'semicolons'} between its columns; write "
            "it with commas"
        )
    doubled = sorted({h for h in header if header.count(h) > 1})
    if doubled:
        raise FileFormatError(f"{path} has the columns {', '.join(doubled)} twice")
    length, angle = _units(header, path)
    joints = _joint_columns(header)
    if lacking := [c for c in _QUATERNION if c not in header]:
        raise FileFormatError(
            f"{path} lacks the columns {', '.join(lacking)}; an orientation is a quaternion "
            f"{', '.join(_QUATERNION)}"
        )
    known = _known(length, joints)
    strange = [h for h in header if h not in known]
    if strange:
        raise FileFormatError(
            f"{path} has columns that a table of grasps does not: {few_of(strange)}; leave them "
            "out, or let joints end with their unit, _rad, _deg, _m or _mm"
        )
    data: dict[str, Any] = {
        "format": "opposable-grasp-table",
        "version": 1,
        "length": length,
        "angle": angle,
        "joint_names": [joint for joint, _ in joints],
        "slides": [joint for joint, column in joints if column.endswith(f"_{length}")],
        "grasps": [],
    }
    for i, row in rows.items():
        where = f"{path}, row {i}"
        if len(row) != len(header):
            raise FileFormatError(f"{where} has {len(row)} values for {len(header)} columns")
        cells = dict(zip(header, row, strict=True))
        for name in ("hand", "base_body"):
            if name in cells and data.setdefault(name, cells[name]) != cells[name]:
                raise FileFormatError(f"{where}: another {name} than the rows before; split it")
        data["grasps"].append(_grasp_of(cells, length, joints, where))
    return data


def _grasp_of(
    cells: Mapping[str, str], length: str, joints: Sequence[tuple[str, str]], where: str
) -> dict[str, Any]:
    """One grasp of a row of text."""

    def numbers(columns: Sequence[str], *, needed: bool = False) -> list[float] | None:
        texts = [cells.get(c, "") for c in columns]
        if not any(texts) and not needed:
            return None
        for column, text in zip(columns, texts, strict=True):
            if not _is_number(text):
                said = repr(text) if text else "an empty cell"
                raise FileFormatError(f"{where}, column {column}: {said} {MEND.format('row')}")
        return [float(t) for t in texts]

    out: dict[str, Any] = {n: cells[n] for n in _TEXTS if n in cells}
    for start, position, turn in (
        ("", "position", "quaternion_wxyz"),
        ("object_", "object_position", "object_quaternion_wxyz"),
    ):
        out[position] = numbers([f"{start}{a}_{length}" for a in _AXES], needed=not start)
        out[turn] = numbers([f"{start}{a}" for a in _QUATERNION], needed=not start)
    for part, prefix in _PREFIXES.items():
        of_part = [f"{prefix}{column}" for _, column in joints]
        out[part] = numbers(of_part, needed=not prefix) if joints else []
    for name in ("scale", "confidence"):
        value = numbers([name])
        out[name] = None if value is None else value[0]
    return {n: v for n, v in out.items() if v is not None}


def _is_number(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


def _units(header: Sequence[str], path: Path) -> tuple[str, str]:
    """Units of lengths and angles, of which a table has one each."""
    lengths = [u for u in LENGTHS if all(f"{a}_{u}" in header for a in _AXES)]
    if len(lengths) != 1:
        raise FileFormatError(
            f"{path} needs the columns x_m, y_m and z_m, or x_mm, y_mm and z_mm; it has "
            f"{few_of(header)}"
        )
    angles = {u for u in ANGLES for h in header if h.endswith(f"_{u}")}
    if len(angles) > 1:
        raise FileFormatError(f"{path} has joints in rad and in deg; give one of both")
    other = [h for u in LENGTHS if u != lengths[0] for h in header if h.endswith(f"_{u}")]
    if other:
        raise FileFormatError(
            f"{path} has positions in {lengths[0]} and {', '.join(other)}; give one unit"
        )
    return lengths[0], angles.pop() if angles else "rad"


def _joint_columns(header: Sequence[str]) -> list[tuple[str, str]]:
    """Joint and column of those that hold the joints of the grasp."""
    places = {f"{s}{a}_{u}" for s in ("", "object_") for a in _AXES for u in LENGTHS}
    ends = tuple(f"_{u}" for u in (*ANGLES, *LENGTHS))
    return [
        (h.rsplit("_", 1)[0], h)
        for h in header
        if h.endswith(ends)
        and h not in places
        and not h.startswith(tuple(p for p in _PREFIXES.values() if p))
    ]


def _known(length: str, joints: Sequence[tuple[str, str]]) -> set[str]:
    """Columns that a table may have."""
    poses = {f"{s}{a}_{length}" for s in ("", "object_") for a in _AXES}
    turns = {f"{s}{a}" for s in ("", "object_") for a in _QUATERNION}
    own = {*_TEXTS, "hand", "base_body", "scale", "confidence"}
    return poses | turns | own | {f"{p}{c}" for p in _PREFIXES.values() for _, c in joints}


def _to_csv(table: TableFile) -> bytes:
    columns = [
        f"{joint}_{table.length if joint in table.slides else table.angle}"
        for joint in table.joint_names
    ]
    parts = [p for p in PARTS if any(getattr(g, p) is not None for g in table.grasps)]
    header = [
        *("name", "hand", "base_body", "object", "scale", "confidence"),
        *(f"{a}_{table.length}" for a in _AXES),
        *_QUATERNION,
        *(f"{_PREFIXES[p]}{c}" for p in parts for c in columns),
        *(f"object_{a}_{table.length}" for a in _AXES),
        *(f"object_{a}" for a in _QUATERNION),
    ]
    text = io.StringIO(newline="")
    writer = csv.writer(text)
    writer.writerow(header)
    for grasp in table.grasps:
        empty = [""] * len(columns)
        writer.writerow(
            [
                *(grasp.name, table.hand, table.base_body, grasp.object, repr(grasp.scale)),
                "" if grasp.confidence is None else repr(grasp.confidence),
                *map(repr, grasp.position),
                *map(repr, grasp.quaternion_wxyz),
                *(v for p in parts for v in map(_cell, getattr(grasp, p) or empty)),
                *map(_cell, grasp.object_position or [""] * 3),
                *map(_cell, grasp.object_quaternion_wxyz or [""] * 4),
            ]
        )
    return text.getvalue().encode()


def _cell(value: float | str) -> str:
    return value if isinstance(value, str) else repr(value)


TABLE_FORMS: Mapping[str, tuple[Callable[[Path], dict[str, Any]], Callable[[TableFile], bytes]]] = (
    MappingProxyType(
        {
            ".json": (_from_json, _to_json),
            ".npz": (_from_npz, _to_npz),
            ".csv": (_from_csv, _to_csv),
        }
    )
)
"""Suffix -> how it is read and written."""
