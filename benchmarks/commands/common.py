"""What the commands that measure share: their options, who works, and how a result is given."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console

from sim.cli.common import EXIT_INTERRUPTED, check_folder, err, heeding_ctrl_c, out, print_json
from sim.cli.options import JsonOption

if TYPE_CHECKING:
    from rich.table import Table

    from sim.runner import Runner

TABLE_WIDTH = 216
"""Least width of the tables, characters: the text columns of ``bench manipulate`` vanish at 140."""

HandsArgument = Annotated[
    list[str], typer.Argument(help="Names or paths of hands.", metavar="HAND...")
]
BothHandsArgument = Annotated[list[str] | None, typer.Argument(help="Hands.", metavar="[HAND]...")]
ObjectsOption = Annotated[
    str,
    typer.Option(help="Objects, comma separated; a folder stands for the mesh files in it."),
]
SamplesOption = Annotated[
    Path, typer.Option(help="Results go here as they come; goes on where it ended.")
]
NumberOption = Annotated[
    int, typer.Option("-n", "--number", min=1, help="How many for each hand and object.")
]
HeightOption = Annotated[
    float, typer.Option(min=0.04, help="Height of cylinder, block and ellipsoid, m.")
]
PRIMITIVES = "sphere,box,cylinder,capsule,ellipsoid"
BOTH_HANDS = ["shadow_hand", "allegro_hand"]
"""Both right hands of the project."""


@dataclass(frozen=True, kw_only=True)
class ResultOptions:
    """Who works on a measurement, and where its result goes."""

    workers: Annotated[int, typer.Option(min=1, help="Processes.")] = 1
    output: Annotated[Path | None, typer.Option("--out", help="Write JSON here.")] = None
    as_json: JsonOption = False

    @contextmanager
    def measuring(self, samples: Path | None = None) -> Iterator[Runner]:
        """Who works: shows how far it is on stderr, and heeds Ctrl-C and SIGTERM.

        Args:
            samples: File of rows that is to be written.
        """
        from sim.runner import Runner

        check_folder(samples)
        check_folder(self.output)
        with heeding_ctrl_c() as check:
            yield Runner(console=err, check=check, workers=self.workers)

    def give(
        self,
        result: dict[str, Any],
        tables: Callable[[dict[str, Any]], Table | str | Iterable[Table | str]],
    ) -> None:
        """Write and print a result; exit as interrupted if it was.

        Args:
            result: Of a measurement.
            tables: What a person sees of it, on a console where tables fit; a narrow terminal
                breaks their lines.
        """
        from rich.table import Table

        from planner.files import write_json

        if self.output is not None:
            write_json(result, self.output)
        if self.as_json:
            print_json(result)
        else:
            shown = tables(result)
            console = Console(width=max(out.width, TABLE_WIDTH))
            for one in (shown,) if isinstance(shown, Table | str) else shown:
                console.print(one, highlight=False, soft_wrap=isinstance(one, str), markup=False)
        if result["interrupted"]:
            raise typer.Exit(EXIT_INTERRUPTED)
