"""What commands read: plans of ours, in files and folders, and grasps in files of other tools.

``ReadingOptions`` is what ``refine`` is told of another tool's file.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from sim.cli.options import flag, names, option

if TYPE_CHECKING:
    from planner.exchange.audit import GraspFile
    from planner.exchange.formats import Reading
    from planner.motion.plan import ManipulationPlan
    from planner.plan import GraspPlan

READING = "What the file does not say"
"""Group of options in the help."""

UNITS = {"m": 1.0, "mm": 1e-3}
"""Of lengths in a file -> m."""

ORDERS = ("wxyz", "xyzw")
"""Of a quaternion."""


@dataclass(frozen=True, kw_only=True)
class ReadingOptions:
    """What a file of another tool does not say of itself."""

    format: Annotated[str | None, option("By its content if not given.", "NAME")] = None
    only: Annotated[str, option("Only grasps whose object's name has this in it.", "TEXT")] = ""
    joint_names: Annotated[
        str | None, option("In the order of the file, comma separated.", "NAMES", READING)
    ] = None
    by_number: Annotated[
        bool, flag("--by-number", "Joints are in the order of the hand.", READING)
    ] = False
    rename: Annotated[
        list[str] | None,
        option("Its name=ours: rh_FFJ4=FFJ4; or TOML, YAML.", "OLD=NEW", READING),
    ] = None
    quaternion: Annotated[str | None, option("Its order.", "wxyz|xyzw", READING)] = None
    unit: Annotated[str | None, option("Of lengths.", "m|mm", READING)] = None
    base_body: Annotated[
        str, option("Body of the hand whose pose the file gives.", "BODY", READING)
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

        for name, value, allowed in (
            ("--quaternion", self.quaternion, ORDERS),
            ("--unit", self.unit, tuple(UNITS)),
        ):
            if value is not None and value not in allowed:
                raise TaskError(
                    f"{name} {shown(value)} is none of {', '.join(allowed)}; give one of them"
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
    """The grasp plan of a file, or of a folder that holds one; of a tool's use its grasp.

    Raises:
        TaskError: The folder holds several, or the file is the plan of a movement.
        FileFormatError: It holds none, or the file is none.
    """
    from planner.errors import TaskError, few_of, shown
    from planner.files import format_told, read_json, read_plan
    from planner.files.disk import MOVEMENT_FORMATS

    files = listed_plans([path])
    if len(files) > 1:
        raise TaskError(
            f"{path} holds {len(files)} plans, and one is taken; give a file of it: "
            f"{few_of(file.name for file in files)}"
        )
    kind = format_told(files[0])
    if kind in MOVEMENT_FORMATS:
        if read_json(files[0], "plan file").get("tool_use"):
            return read_plan(files[0])
        raise TaskError(
            f"{files[0]} is of the format {shown(kind)}, and the plan of a grasp is taken; "
            f"opposable manipulate --plan {files[0]} executes a turn in the hand, opposable test "
            f"{files[0]} a handover or the use of a tool, and opposable export --to "
            "ros2-trajectory writes the joints over time"
        )
    return read_plan(files[0])


def plan_to_test(path: Path) -> GraspPlan | ManipulationPlan:
    """The plan of a grasp, a handover or the use of a tool.

    Raises:
        TaskError: As ``one_plan``.
        FileFormatError: The file is none.
    """
    from planner.files import format_told, read_json, read_manipulation
    from planner.files.disk import HANDOVER_FORMAT

    if not path.is_dir():
        data = read_json(path, "plan file")
        if format_told(path) == HANDOVER_FORMAT or data.get("handover") or data.get("tool"):
            return read_manipulation(path)
    return one_plan(path)


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
