"""``export_plans``: plans into a file of another tool, or a refusal that says what is wrong."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path

from planner.errors import TaskError
from planner.exchange.formats import FORMATS, GraspFormat, Writing, format_named
from planner.exchange.joints import channels_of
from planner.exchange.sources import AnyPlan, task_of_plan
from planner.plan import GraspPlan

__all__ = ["Export", "check_export", "export_plans"]


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


def check_export(name: str, writing: Writing | None = None) -> GraspFormat:
    """The format of a name, seen to be writable with these names of frames and joints.

    Raises:
        NotFoundError: There is no such format.
        TaskError: It has no writer, or no use for something that is given.
    """
    chosen = format_named(name)
    if chosen.write is None:
        able = ", ".join(f.name for f in FORMATS.values() if f.write is not None)
        raise TaskError(f"{name} is read only; formats that are written: {able}")
    told = writing or Writing()
    given = {f.name for f in fields(Writing) if getattr(told, f.name) != getattr(Writing(), f.name)}
    if unused := sorted(given - chosen.heeds):
        heeded = ", ".join(sorted(chosen.heeds)) or "nothing of the kind"
        raise TaskError(f"{name} has no place for {', '.join(unused)}; it takes {heeded}")
    return chosen


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
        TaskError: No plan, a format without a writer, or something that it cannot carry.
        FileFormatError: The file cannot be written.
    """
    told = writing or Writing()
    chosen = check_export(format, told)
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
