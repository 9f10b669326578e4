"""File formats of other tools by name, and grasps as such a file tells them.

A format is one module or folder, and one registration; it reads grasps, writes plans, or both.
``opposable refine`` reads whatever is registered here, ``opposable export`` writes it.

Every reader makes ``ImportedGrasps``: poses and joints, of which nothing is verified, in the
conventions of this package and in the order of our hand's joints; ``planner.exchange.audit`` and
``planner.search.refine`` take them from there.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from planner.errors import FileFormatError, NotFoundError, TaskError, few_of, shown
from planner.exchange.array_files import ARRAY_SUFFIXES, read_array_file
from planner.hands.hand import Hand
from planner.immutable import freeze
from planner.registry import plugin, plugin_names
from planner.spatial import SE3, FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class ImportedGrasp:
    """One grasp of a file.

    Attributes:
        name: What the file calls it, or where in the file it is ("row 12").
        T_object_base: Pose of the hand's base in the frame of the object's own file, scaled; ours
            has its origin at the centre of mass (``planner.exchange.joints.T_file_object``).
        q: Joints at the grasp (nq,), rad (m for slides), order of ``hand.joint_names``.
        q_pregrasp: Joints (nq,) before the grasp; None where the file has none.
        q_squeeze: Joints (nq,) that are commanded to press; None where the file has none.
        object: The object as the file names it, a path or a name; "" where it says nothing.
        scale: Factor on the object's mesh.
        T_world_object: Where that frame is; None where the file says nothing.
        confidence: As the file gives it, without a unit; None where it gives none.
    """

    name: str
    T_object_base: SE3
    q: FloatArray
    q_pregrasp: FloatArray | None = None
    q_squeeze: FloatArray | None = None
    object: str = ""
    scale: float = 1.0
    T_world_object: SE3 | None = None
    confidence: float | None = None

    def __post_init__(self) -> None:
        """Keep read-only copies."""
        held = ("q", *(n for n in ("q_pregrasp", "q_squeeze") if getattr(self, n) is not None))
        poses = ("T_object_base", *(() if self.T_world_object is None else ("T_world_object",)))
        freeze(self, poses=poses, arrays=held)


@dataclass(frozen=True, kw_only=True)
class ImportedGrasps:
    """All grasps of a file.

    Attributes:
        source: The file or folder.
        format: Name of its format, as in ``planner.exchange.formats.FORMATS``.
        hand: The hand as the file names it; "" where it says nothing.
        grasps: In the order of the file.
        assumed: What the file does not say and was taken for granted, a sentence each.
    """

    source: Path
    format: str
    hand: str
    grasps: tuple[ImportedGrasp, ...]
    assumed: tuple[str, ...] = ()

    def __len__(self) -> int:
        """Number of grasps."""
        return len(self.grasps)


def joints_by_name(
    hand: Hand,
    names: Sequence[str],
    values: FloatArray,
    *,
    where: str,
    other_names: Mapping[str, str] | None = None,
) -> FloatArray:
    """Joints in the order of our hand, from values that a file gives by name.

    Args:
        hand: Our hand.
        names: Joint names of the file.
        values: Their values (n,) or (m, n).
        where: Place in the file, for messages.
        other_names: Name in the file -> name of our joint, where they differ.

    Returns:
        (nq,) or (m, nq).

    Raises:
        FileFormatError: A joint of the hand is missing, is named twice, or a name is unknown; or
            there are more or fewer values than names.
    """
    mine = [(other_names or {}).get(name, name) for name in names]
    missing = [name for name in hand.joint_names if name not in mine]
    foreign = [name for name in mine if name not in hand.joint_names]
    doubled = sorted({name for name in mine if mine.count(name) > 1})
    if doubled:
        raise FileFormatError(f"{where} names twice {few_of(doubled)}; name every joint once")
    if missing or foreign:
        parts = [f"lacks {few_of(missing)}"] * bool(missing)
        parts += [f"names {few_of(foreign)}, which {hand.name} does not have"] * bool(foreign)
        raise FileFormatError(
            f"{where} does not fit {hand.name}: it {' and '.join(parts)}; give the hand that the "
            "file is for with --hand, or say which joint is which with --rename THEIRS=OURS"
        )
    array = np.asarray(values, dtype=float)
    if array.shape[-1] != len(mine):
        raise FileFormatError(
            f"{where} has {array.shape[-1]} values for {len(mine)} joint names; it is damaged"
        )
    return np.array(array[..., [mine.index(name) for name in hand.joint_names]])


BY = ("joints", "actuators")
"""What numbers in a file may belong to."""


@dataclass(frozen=True, kw_only=True)
class Reading:
    """What a file does not say of itself and its reader may be told.

    Attributes:
        by_number: Whether joints without names are taken in the order of our hand; else a file
            without names is refused.
        joint_names: Names of the joints in the order of the file; None where the file says them.
        quaternion: "wxyz" or "xyzw"; None for what the format fixes, or what the numbers tell.
        unit: Lengths of the file in metres: 1, or 0.001 for millimetres; None for what the format
            fixes.
        base_body: Body of the hand whose pose the file gives; "" for the hand's base.
        rename: Name of a joint in the file -> name of our joint, where they differ.
    """

    by_number: bool = False
    joint_names: tuple[str, ...] | None = None
    rename: Mapping[str, str] = field(default_factory=dict)
    quaternion: str | None = None
    unit: float | None = None
    base_body: str = ""


@dataclass(frozen=True, kw_only=True)
class Writing:
    """What a file says that a plan does not, or says by other names.

    Attributes:
        rename: Name of our joint, or of our actuator where ``by`` says so -> its name in the file;
            names that are not in it stay.
        by: "joints" for positions of joints, "actuators" for lengths of actuators, which is what
            a driver is told that has one motor for several joints.
        object_frame: Name of the object's frame; "" for the object's name.
        hand_frame: Name of the frame of ``base_body``; "" for that body's name.
        base_body: Body of the hand whose pose is written; "" for the hand's base.
        world_frame: Name of the world's frame, and then poses are written in it; "" for poses in
            the object's frame.
    """

    rename: Mapping[str, str] = field(default_factory=dict)
    by: str = "joints"
    object_frame: str = ""
    hand_frame: str = ""
    base_body: str = ""
    world_frame: str = ""

    def __post_init__(self) -> None:
        """Check what has a few values only."""
        if self.by not in BY:
            raise TaskError(f"by is {shown(self.by)}; give {' or '.join(BY)}")


@dataclass(frozen=True, kw_only=True)
class GraspFormat:
    """A file format of another tool.

    Attributes:
        name: Lower case with hyphens, for example "isaac-grasp".
        title: What it is, in a few words, with the version and whose it is.
        suffixes: How its files may end, the usual ending first; () for a folder.
        loses: What of a plan does not come back from it, a sentence; "" for nothing.
        recognises: Whether a file looks like it, without reading more than is needed; never raises
            but for a file that cannot be opened.
        read: Reads grasps for one of our hands; None where there is no reader. Raises
            ``FileFormatError`` that names the place.
        write: Writes plans to a path and returns the files; None where there is no writer. Writes
            everything or nothing. Raises ``TaskError`` for what the format cannot carry.
        heeds: Names of the fields of ``Writing`` that ``write`` heeds; ``export_plans`` refuses the
            others.
        movements: Whether ``write`` takes motions, gaits and manipulation plans as well.
        hand_of: What a file calls its hand, as ``load_hand`` takes it, "" where it says nothing;
            None for a format whose files name no hand of ours.
        object_specs: Whether ``ImportedGrasp.object`` is what ``parse_object`` takes, and not only
            what the other tool calls the object.
    """

    name: str
    title: str
    suffixes: tuple[str, ...]
    loses: str
    recognises: Callable[[Path], bool]
    read: Callable[[Path, Hand, Reading], ImportedGrasps] | None = None
    write: Callable[[Sequence[Any], Path, Writing], tuple[Path, ...]] | None = None
    heeds: frozenset[str] = frozenset()
    movements: bool = False
    hand_of: Callable[[Path], str] | None = None
    object_specs: bool = False


FORMATS: dict[str, GraspFormat] = {}
"""All formats by name; filled by ``load_formats``."""

_MODULES: tuple[str, ...] = (
    "dexgraspbench.read",
    "isaac_grasp",
    "ros.grasp",
    "table",
)
"""Modules below ``planner.exchange`` that register a format when they are imported."""


def register_format(grasp_format: GraspFormat) -> GraspFormat:
    """Register a format under its name.

    Raises:
        TaskError: The name is taken, or the format neither reads nor writes.
    """
    if grasp_format.name in FORMATS:
        raise TaskError(f"the format {grasp_format.name!r} exists; give yours another name")
    if grasp_format.read is None and grasp_format.write is None:
        raise TaskError(f"format {grasp_format.name!r} neither reads nor writes; give one of both")
    FORMATS[grasp_format.name] = grasp_format
    return grasp_format


def load_formats() -> None:
    """Import the formats of this package and of installed ones (``planner.registry``)."""
    for name in _MODULES:
        import_module(f"planner.exchange.{name}")
    for name in plugin_names("formats"):
        if name not in FORMATS:
            register_format(plugin("formats", name))


def format_named(name: str) -> GraspFormat:
    """The format of a name.

    Raises:
        NotFoundError: There is none.
    """
    load_formats()
    if name not in FORMATS:
        raise NotFoundError("format", name, FORMATS)
    return FORMATS[name]


def readable_format(name: str) -> GraspFormat:
    """The format of a name, which is read.

    Raises:
        NotFoundError: There is none.
        TaskError: It is written only.
    """
    return _able(name, "read", "written")


def writable_format(name: str) -> GraspFormat:
    """The format of a name, which is written.

    Raises:
        NotFoundError: There is none.
        TaskError: It is read only.
    """
    return _able(name, "write", "read")


def _able(name: str, verb: str, other: str) -> GraspFormat:
    load_formats()
    able = sorted(f.name for f in FORMATS.values() if getattr(f, verb) is not None)
    if name in able:
        return FORMATS[name]
    if name not in FORMATS:
        raise NotFoundError("format", name, able)
    done = {"read": "read", "write": "written"}[verb]
    raise TaskError(f"{name} is {other} only; formats that are {done}: {', '.join(able)}")


def format_of(path: Path) -> GraspFormat:
    """The readable format that a file looks like.

    Raises:
        FileFormatError: It looks like none, or like several.
        NotFoundError: There is no such file.
    """
    load_formats()
    if not path.exists():
        raise NotFoundError("file", str(path), (), "give the path of a file", is_path=True)
    readable = [f for f in FORMATS.values() if f.read is not None]
    like = [f for f in readable if f.recognises(path)]
    if len(like) == 1:
        return like[0]
    if not like:
        _need_readable(path)
    names = ", ".join(f.name for f in like or readable)
    said = f"looks like {names}" if like else f"looks like none of {names}"
    raise FileFormatError(f"{path} {said}; say which with --format")


def _need_readable(path: Path) -> None:
    """Say of a file of arrays that it is damaged or hostile, rather than that it is of no form.

    Raises:
        FileFormatError: It is.
    """
    files = sorted(path.rglob("*.npy"))[:1] if path.is_dir() else [path]
    for file in files:
        if file.suffix in ARRAY_SUFFIXES:
            read_array_file(file)
