"""Commands for many grasps: ``batch``, ``extract``."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape

from sim.cli.common import (
    EXIT_INTERRUPTED,
    EXIT_NOT_FOUND,
    HandArgument,
    JsonOption,
    check_folder,
    err,
    errors_for_people,
    out,
    print_json,
    say,
)
from sim.cli.options import PlanOptions, with_options

TABLE_WIDTH = 110
"""Width of the table, characters."""


class Export(StrEnum):
    """Formats of other projects that a batch is exported to."""

    dexgraspbench = "dexgraspbench"


@errors_for_people()
@with_options
def batch(
    hand: HandArgument,
    objects: Annotated[
        list[str], typer.Argument(help="Objects as `plan` takes them.", metavar="OBJECT...")
    ],
    n: Annotated[
        int, typer.Option("-n", "--number", min=1, help="Grasps per object.", metavar="N")
    ] = 100,
    folder: Annotated[
        Path, typer.Option("--out", help="Folder; a batch that is there goes on.", metavar="DIR")
    ] = Path("grasps"),
    workers: Annotated[int, typer.Option(help="Processes; -1 for one per core.", metavar="N")] = -1,
    backend: Annotated[
        str | None,
        typer.Option(help="fork, loky, threading; fork where possible if none.", metavar="NAME"),
    ] = None,
    *,
    request: PlanOptions,
    export: Annotated[
        Export | None, typer.Option(help="Also write OUT/dexgraspbench.", metavar="FORMAT")
    ] = None,
    export_all: Annotated[
        bool,
        typer.Option("--export-all", help="Fail where the format cannot take a grasp.", metavar=""),
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Plan many grasps on all cores into a Parquet dataset.

    An interrupted batch goes on when the same command is given again.

    What says how an object is, stands and may be touched holds for all objects.
    """
    from planner.batch import plan_grasps
    from planner.exchange.dexgraspbench import export_dexgraspbench
    from planner.files import write_json
    from planner.hand_loading import load_hand
    from planner.search import DEFAULT_MAX_ATTEMPTS
    from sim.cli.batch_report import BatchBar, batch_summary, batch_table

    loaded = load_hand(hand)
    tasks = [request.task(loaded, item) for item in objects]
    options = request.synthesis()
    with BatchBar(err) as bar:
        try:
            grasps = plan_grasps(
                loaded,
                tasks,
                n,
                seed=request.seed,
                workers=workers,
                backend=backend,
                out=folder,
                max_attempts=request.max_attempts or DEFAULT_MAX_ATTEMPTS,
                max_cpu_s=request.max_cpu_s,
                options=options,
                progress=bar.told,
            )
        except KeyboardInterrupt as error:
            say(err, escape(f"interrupted: {bar.kept()}; the same command goes on"))
            raise typer.Exit(EXIT_INTERRUPTED) from error
    summary: dict[str, Any] = batch_summary(grasps)
    write_json(summary, folder / "summary.json")
    if export is not None:
        exported = export_dexgraspbench(grasps, folder / export.value, need_all=export_all)
        say(err, escape(f"{exported.summary}: {folder / export.value}"))
    if as_json:
        print_json(summary)
    else:
        # the table does not fit into 80 columns; a narrow terminal breaks its lines
        Console(width=max(out.width, TABLE_WIDTH)).print(batch_table(summary))
        say(out, escape(f"written to {folder}: grasps/, attempts/, manifest.json, summary.json"))
    if not any(item["found"] for item in summary["objects"]):
        raise typer.Exit(EXIT_NOT_FOUND)


@errors_for_people()
def extract(
    folder: Annotated[Path, typer.Argument(help="Folder of a batch.", metavar="FOLDER")],
    row: Annotated[int, typer.Argument(min=0, help="Number of the row, from 0.", metavar="ROW")],
    output: Annotated[Path, typer.Option("--out", "-o", help="The plan file.")] = Path("plan.json"),
) -> None:
    """Verify a grasp of a batch again; write it as a plan file."""
    from planner.batch import GraspSet
    from planner.errors import NotFoundError
    from planner.files import write_plan

    check_folder(output)
    grasps = GraspSet(folder)
    if row >= len(grasps):
        raise NotFoundError("row", str(row), [f"0 to {len(grasps) - 1}"])
    write_plan(grasps.plan(row), output)
    say(out, escape(f"written to {output}"))
