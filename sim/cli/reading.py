"""What commands read: plans of ours, in files and folders, and grasps in files of other tools.

``ReadingOptions`` is what ``audit`` and ``refine`` are told of another tool's file.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sim.cli.common import names

if TYPE_CHECKING:
    from planner.exchange.audit import GraspFile
    from planner.exchange.formats import Reading
    from planner.plan import GraspPlan

READING_PANEL = "What the file does not say"
"""Group of options in the help."""

UNITS = {"m": 1.0, "mm": 1e-3}
"""Of lengths in a file -> m."""

ORDERS = ("wxyz", "xyzw")
"""Of a quaternion."""


MOVEMENTS = ("opposable-motion", "opposable-gait", "opposable-manipulation")
"""Formats of plans that are movements."""


@dataclass(frozen=True, kw_only=True)
class ReadingOptions:
    """What a file of another tool does not say of itself."""

    format: Annotated[
        str | None, typer.Option(help="By its content if not given.", metavar="NAME")
    ] = None
    only: Annotated[
        str, typer.Option(help="Only grasps whose object's name has this in it.", metavar="TEXT")
    ] = ""
    joint_names: Annotated[
        str | None,
        typer.Option(
            help="In the order of the file, comma separated.",
            metavar="NAMES",
            rich_help_panel=READING_PANEL,
        ),
    ] = None
    by_number: Annotated[
        bool,
        typer.Option(
            "--by-number",
            help="Joints are in the order of the hand.",
            metavar="",
            rich_help_panel=READING_PANEL,
        ),
    ] = False
    rename: Annotated[
        list[str] | None,
        typer.Option(
            help="Its name=ours: rh_FFJ4=FFJ4; or TOML, YAML.",
            metavar="OLD=NEW",
            rich_help_panel=READING_PANEL,
        ),
    ] = None
    quaternion: Annotated[
        str | None,
        typer.Option(help="Its order.", metavar="wxyz|xyzw", rich_help_panel=READING_PANEL),
    ] = None
    unit: Annotated[
        str | None, typer.Option(help="Of lengths.", metavar="m|mm", rich_help_panel=READING_PANEL)
    ] = None
    base_body: Annotated[
        str,
        typer.Option(
            help="Body of the hand whose pose the file gives.",
            metavar="BODY",
            rich_help_panel=READING_PANEL,
        ),
    ] = ""

    def open(self, file: Path) -> GraspFile:
        """A file of another tool.

        Raises:
            PlannerError: No such file or format, or something told that there is not.
        """
        from planner.exchange.audit import GraspFile

        return GraspFile.open(file, format=self.format, reading=self.reading(), only=self.only)

    def reading(self) -> Reading:
        """As readers take it.

        Raises:
            TaskError: A unit or an order that there is not.
        """
        from planner.errors import TaskError, shown
        from planner.exchange.formats import Reading

        for option, value, allowed in (
            ("--quaternion", self.quaternion, ORDERS),
            ("--unit", self.unit, tuple(UNITS)),
        ):
            if value is not None and value not in allowed:
                raise TaskError(
                    f"{option} {shown(value)} is none of {', '.join(allowed)}; give one of them"
                )
        return Reading(
            by_number=self.by_number,
            joint_names=None if self.joint_names is None else tuple(names(self.joint_names)),
            rename=renaming(self.rename or ()),
            quaternion=self.quaternion,
            unit=None if self.unit is None else UNITS[self.unit],
            base_body=self.base_body,
        )


def our_kind(file: Path) -> str | None:
    """What of ours a path is: a "plan" file, a folder of "plans", a "batch"; None for another.

    Raises:
        FileFormatError: It cannot be read.
    """
    from planner.batch.recipe import MANIFEST
    from planner.files import format_told, plan_files

    if file.is_dir():
        if (file / MANIFEST).is_file():
            return "batch"
        return "plans" if plan_files(file) else None
    return "plan" if format_told(file) == "opposable-plan" else None


def listed_plans(paths: Sequence[Path]) -> list[Path]:
    """Plan files, with those of each folder in its place.

    Raises:
        FileFormatError: A folder holds none.
    """
    from planner.errors import FileFormatError
    from planner.files import plan_files

    files: list[Path] = []
    for path in paths:
        found = plan_files(path) if path.is_dir() else (path,)
        if not found:
            raise FileFormatError(f"{path} is a folder without plan files; give plan files")
        files += found
    return files


def one_plan(path: Path) -> GraspPlan:
    """The plan of a file, or of a folder that holds one.

    Raises:
        TaskError: The folder holds several, or the file is the plan of a movement.
        FileFormatError: It holds none, or the file is none.
    """
    from planner.errors import TaskError, few_of, shown
    from planner.files import format_told, read_plan

    files = listed_plans([path])
    if len(files) > 1:
        raise TaskError(
            f"{path} holds {len(files)} plans, and one is taken; give a file of it: "
            f"{few_of(file.name for file in files)}"
        )
    kind = format_told(files[0])
    if kind in MOVEMENTS:
        raise TaskError(
            f"{files[0]} is of the format {shown(kind)}, and the plan of a grasp is taken; "
            f"opposable manipulate --plan {files[0]} executes it in simulation, and opposable "
            "export --to ros2-trajectory writes its joints over time"
        )
    return read_plan(files[0])


def refuse_beside_ours(context: typer.Context, file: Path, kept: Collection[str]) -> None:
    """Refuse options about hand, object and surroundings, where a file of ours brings them.

    Args:
        context: Of the command.
        file: The file or folder of ours.
        kept: Names of the parameters that go with it.

    Raises:
        TaskError: Others are given.
    """
    from planner.errors import TaskError

    given = [
        parameter.opts[0]
        for parameter in context.command.params
        if parameter.name not in kept
        and (source := context.get_parameter_source(parameter.name or "")) is not None
        and source.name == "COMMANDLINE"
    ]
    if given:
        raise TaskError(
            f"{file} brings hand, object and surroundings; leave {', '.join(given)} out"
        )


def renaming(given: Sequence[str]) -> dict[str, str]:
    """Names -> names, out of OLD=NEW and of files; the value of ``--rename``.

    Raises:
        TaskError: A name is missing.
        FileFormatError: A file cannot be read.
    """
    from planner.errors import TaskError
    from planner.exchange.joints import read_renaming

    found: dict[str, str] = {}
    for text in given:
        old, sign, new = text.partition("=")
        if not sign:
            found |= read_renaming(Path(text))
        elif old.strip() and new.strip():
            found[old.strip()] = new.strip()
        else:
            raise TaskError(f"--rename {text!r} lacks a name; give OLD=NEW, or a TOML or YAML file")
    return found
