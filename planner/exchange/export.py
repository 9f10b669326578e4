"""``export_plans``: plans into a file of another tool, or a refusal that says what is wrong."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path

from planner.errors import TaskError
from planner.exchange.formats import FORMATS, GraspFormat, Writing, writable_format
from planner.exchange.joints import channels_of
from planner.exchange.sources import AnyPlan, task_of_plan
from planner.plan import GraspPlan


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
        for hand in {id(h): h for h in (task_of_plan(plan).hand for plan in plans)}.values():
            notes.update(dict.fromkeys(channels_of(hand, told).said))
    files = chosen.write(plans, Path(path), told)
    return Export(
        format=format, count=len(plans), files=files, lost=chosen.loses, notes=tuple(notes)
    )
