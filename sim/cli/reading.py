"""What ``audit`` and ``refine`` are told of a file of grasps, and whose file it is."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sim.cli.common import names

if TYPE_CHECKING:
    from planner.exchange.formats import Reading

__all__ = ["ReadingOptions", "our_kind"]

READING_PANEL = "What the file does not say"
"""Group of options in the help."""

UNITS = {"m": 1.0, "mm": 1e-3}
"""Of lengths in a file -> m."""

ORDERS = ("wxyz", "xyzw")
"""Of a quaternion."""

HEAD = 4096
"""Bytes of a file that say whose it is."""


@dataclass(frozen=True, kw_only=True)
class ReadingOptions:
    """What a file of another tool does not say of itself."""

    format: Annotated[
        str | None, typer.Option(help="By its content if not given.", metavar="NAME")
    ] = None
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

    def reading(self) -> Reading:
        """As readers take it.

        Raises:
            TaskError: A unit or an order that there is not.
        """
        from planner.errors import TaskError
        from planner.exchange.formats import Reading

        for option, value, allowed in (
            ("--quaternion", self.quaternion, ORDERS),
            ("--unit", self.unit, tuple(UNITS)),
        ):
            if value is not None and value not in allowed:
                raise TaskError(
                    f"{option} {value!r} is none of {', '.join(allowed)}; give one of them"
                )
        return Reading(
            by_number=self.by_number,
            joint_names=None if self.joint_names is None else tuple(names(self.joint_names)),
            quaternion=self.quaternion,
            unit=None if self.unit is None else UNITS[self.unit],
            base_body=self.base_body,
        )


def our_kind(file: Path) -> str | None:
    """Whether a file is a "plan" of ours, or a folder a "batch"; None for another."""
    from planner.batch.manifest import MANIFEST

    if file.is_dir():
        return "batch" if (file / MANIFEST).is_file() else None
    if file.suffix != ".json" or not file.is_file():
        return None
    with file.open("rb") as stream:
        return "plan" if b'"opposable-plan"' in stream.read(HEAD) else None
