"""What the commands that measure share: their options, who works, and how a result is given."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console

from sim.cli.common import EXIT_INTERRUPTED, check_folder, err, heeding_ctrl_c, out, print_json

if TYPE_CHECKING:
    from sim.runner import Runner

TABLE_WIDTH = 216
"""Characters that the benchmark's tables need at least: columns of names are the first that give
way, and those of ``bench manipulate`` were gone at 140."""

HandsArgument = Annotated[
    list[str], typer.Argument(help="Names or paths of hands.", metavar="HAND...")
]
ObjectsOption = Annotated[
    str,
    typer.Option(help="Objects, comma separated; a folder stands for the mesh files in it."),
]
OutOption = Annotated[Path | None, typer.Option("--out", help="Write JSON here.")]
SamplesOption = Annotated[
    Path, typer.Option(help="Results go here as they come; goes on where it ended.")
]
NumberOption = Annotated[
    int, typer.Option("-n", "--number", min=1, help="How many for each hand and object.")
]
HeightOption = Annotated[
    float, typer.Option(min=0.04, help="Height of cylinder, block and ellipsoid, m.")
]
WorkersOption = Annotated[int, typer.Option(min=1, help="Processes.")]
PRIMITIVES = "sphere,box,cylinder,capsule,ellipsoid"


@contextmanager
def measuring(output: Path | None, workers: int) -> Iterator[Runner]:
    """Who works on a measurement: shows how far it is on stderr, and heeds Ctrl-C and SIGTERM."""
    from sim.runner import Runner

    check_folder(output)
    with heeding_ctrl_c() as check:
        yield Runner(console=err, check=check, workers=workers)


def give(
    result: dict[str, Any], output: Path | None, as_json: bool, show: Callable[[Console], None]
) -> None:
    """Write and print a result; exit as interrupted if it was.

    Args:
        result: Of a measurement.
        output: Where it is written, if anywhere.
        as_json: Whether it is printed as it is, and not shown.
        show: Shows it on a console where the tables fit; a narrow terminal breaks their lines.
    """
    from planner.files import write_json

    if output is not None:
        write_json(result, output)
    if as_json:
        print_json(result)
    else:
        show(Console(width=max(out.width, TABLE_WIDTH)))
    if result["interrupted"]:
        raise typer.Exit(EXIT_INTERRUPTED)
