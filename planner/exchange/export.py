"""``export_plans``: plans into a file of another tool, or a refusal that says what is wrong.

What there is to export: plan files of any kind, folders of them, and grasps of batches.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields
from itertools import islice
from pathlib import Path
from typing import Any, TypeAlias

from planner.batch.dataset import GraspSet
from planner.batch.recipe import MANIFEST
from planner.errors import FileFormatError, NotFoundError, TaskError, shown
from planner.exchange.formats import FORMATS, GraspFormat, Writing, writable_format
from planner.exchange.joints import channels_of
from planner.files import plan_files, read_json, read_movement, read_plan
from planner.files.disk import MOVEMENT_FORMATS
from planner.motion.plan import MovementPlan
from planner.plan import GraspPlan

AnyPlan: TypeAlias = GraspPlan | MovementPlan
"""What has a joint trajectory."""

_READERS: dict[str, Callable[[Path], AnyPlan]] = {
    "opposable-plan": read_plan,
    **dict.fromkeys(MOVEMENT_FORMATS, read_movement),
}
"""Format that a file says of itself -> its reader."""


def plans_of(
    paths: Sequence[Path], *, objects: Sequence[str] | None = None, first: int | None = None
) -> Iterator[AnyPlan]:
    """Plans of files and of folders of batches, each verified again as it is read.

    Args:
        paths: Plan files, folders of plan files, and folders that ``plan_grasps`` wrote.
        objects: Labels of the objects of a batch that are wanted; all if None.
        first: At most so many grasps of each object of a batch; all if None.

    Raises:
        NotFoundError: There is no such file, or a batch has no such object.
        FileFormatError: A file is no plan, is damaged, or fails its checks now.
        TaskError: Objects or a number are given without a batch.
    """
    batches = [path for path in paths if (path / MANIFEST).is_file()]
    if not batches and (objects is not None or first is not None):
        raise TaskError(
            "objects and the number of grasps choose from a batch, and no folder of a batch is "
            "given; leave them out, or give the folder"
        )
    for path in paths:
        if path in batches:
            yield from _of_batch(GraspSet(path), objects, first)
        elif not path.exists():
            raise NotFoundError(
                "file", str(path), (), "give plan files, or the folder of a batch", is_path=True
            )
        elif path.is_dir():
            files = plan_files(path, _READERS)
            if not files:
                raise FileFormatError(
                    f"{path} holds neither plan files nor a batch; give plan files, a folder of "
                    "them, or the folder of a batch"
                )
            yield from map(_of_file, files)
        else:
            yield _of_file(path)


def _of_batch(
    grasps: GraspSet, objects: Sequence[str] | None, first: int | None
) -> Iterator[GraspPlan]:
    for label in objects or ():
        if label not in grasps.labels:
            raise NotFoundError("object of the batch", label, grasps.labels)
    for label in grasps.labels if objects is None else objects:
        for number, _ in islice(grasps.found(label), first):
            yield grasps.plan(number)


def _of_file(path: Path) -> AnyPlan:
    data: dict[str, Any] = read_json(path, "a plan")
    read = _READERS.get(str(data.get("format")))
    if read is None:
        raise FileFormatError(
            f"{path} is of the format {shown(data.get('format'))}; what can be exported is "
            f"{', '.join(_READERS)}, folders of these, and of batches"
        )
    return read(path)


@dataclass(frozen=True, kw_only=True)
class Export:
    """Result of an export.

    Attributes:
        format: Name of the format.
        count: Plans written.
        files: What was written.
        lost: What of a plan does not come back from it; "" for nothing.
        notes: What a reader must know of joints: which are left out, which are commanded together.
    """

    format: str
    count: int
    files: tuple[Path, ...]
    lost: str
    notes: tuple[str, ...]


FILE_SUFFIXES = (
    *(".csv", ".json", ".npy", ".npz", ".txt", ".toml", ".yaml", ".yml"),
    *(".mjcf", ".urdf", ".xml", ".zip"),
)
"""Endings by which a name is meant for a file, where a format is a folder."""


def check_export(name: str, path: Path, writing: Writing | None = None) -> GraspFormat:
    """The format of a name, seen to be writable there with these names of frames and joints.

    Raises:
        NotFoundError: There is no such format.
        TaskError: It has no writer, its files do not end so, or it has no use for something that
            is given.
    """
    chosen = writable_format(name)
    _need_suffix(chosen, path)
    told = writing or Writing()
    given = {f.name for f in fields(Writing) if getattr(told, f.name) != getattr(Writing(), f.name)}
    if unused := sorted(given - chosen.heeds):
        heeded = ", ".join(sorted(chosen.heeds)) or "nothing of the kind"
        raise TaskError(f"{name} has no place for {', '.join(unused)}; it takes {heeded}")
    return chosen


def _need_suffix(chosen: GraspFormat, path: Path) -> None:
    """Refuse a path that does not end as the files of a format do.

    Raises:
        TaskError: So.
    """
    ending, allowed = path.suffix.lower(), chosen.suffixes
    if not allowed and ending in FILE_SUFFIXES:
        raise TaskError(
            f"{path} ends with {path.suffix}, and {chosen.name} is a folder; name one: "
            f"{path.with_suffix('')}"
        )
    if allowed and ending not in allowed:
        said = f"ends with {path.suffix}" if ending else "has no ending"
        raise TaskError(
            f"{path} {said}, and files of {chosen.name} end with {' or '.join(allowed)}; name it "
            f"{path.parent / (path.stem or 'grasps')}{allowed[0]}"
        )


def export_plans(
    plans: Sequence[AnyPlan], path: Path | str, format: str, *, writing: Writing | None = None
) -> Export:
    """Write plans for another tool, everything or nothing.

    Args:
        plans: At least one; motions, gaits and manipulation plans where the format takes them.
        path: The file, or the folder for a format that is one.
        format: Name of the format; ``planner.exchange.formats.FORMATS`` has them.
        writing: Names of frames and joints; ours if None.

    Raises:
        NotFoundError: There is no such format.
        TaskError: No plan, a format without a writer, a path with another ending, or something
            that the format cannot carry.
        FileFormatError: The file cannot be written.
    """
    told = writing or Writing()
    chosen = check_export(format, Path(path), told)
    if not plans:
        raise TaskError("there are no plans to export; give at least one")
    for plan in plans:
        if not isinstance(plan, GraspPlan) and not chosen.movements:
            able = ", ".join(f.name for f in FORMATS.values() if f.movements)
            raise TaskError(
                f"{format} carries grasps, and a {type(plan).__name__} is a movement as well; "
                f"formats for movements: {able}; or export the grasp of the plan"
            )
    assert chosen.write is not None  # checked above
    notes: dict[str, None] = {}
    if "rename" in chosen.heeds:
        for hand in {id(h): h for h in (plan.task.hand for plan in plans)}.values():
            notes.update(dict.fromkeys(channels_of(hand, told).said))
    files = chosen.write(plans, Path(path), told)
    return Export(
        format=format, count=len(plans), files=files, lost=chosen.loses, notes=tuple(notes)
    )
