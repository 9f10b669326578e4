"""Commands that measure: ``bench grasps``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from sim.cli.common import (
    EXIT_INTERRUPTED,
    JsonOption,
    SimMuOption,
    check_folder,
    err,
    errors_for_people,
    names,
    out,
    print_json,
)

TABLE_WIDTH = 120
"""Characters that the benchmark's table needs."""


@errors_for_people()
def bench_grasps(
    hands: Annotated[str, typer.Option(help="Hands, comma separated.")] = (
        "shadow_hand,allegro_hand"
    ),
    objects: Annotated[str, typer.Option(help="Objects, comma separated.")] = (
        "sphere,box,cylinder,capsule,ellipsoid"
    ),
    seeds: Annotated[int, typer.Option(min=1, help="Seeds per cell, from 0.")] = 10,
    sim_mu: SimMuOption = 0.6,
    workers: Annotated[int, typer.Option(min=1, help="Processes.")] = 1,
    output: Annotated[Path | None, typer.Option("--out", help="Write JSON here.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Plan and execute hands x objects x seeds; the table of the README."""
    from planner.files import write_json
    from sim.benchmark import bench_table, run_benchmark

    check_folder(output)
    result = run_benchmark(
        names(hands), names(objects), range(seeds), mu=sim_mu, workers=workers, console=err
    )
    if output is not None:
        write_json(result, output)
    if as_json:
        print_json(result)
    else:
        # the table does not fit into 80 columns; a narrow terminal breaks its lines
        Console(width=max(out.width, TABLE_WIDTH)).print(bench_table(result))
    if result["interrupted"]:
        raise typer.Exit(EXIT_INTERRUPTED)


def register(app: typer.Typer) -> None:
    """Add the group ``bench``."""
    bench = typer.Typer(
        help="Measure: tables that repeat the project's figures.", no_args_is_help=True
    )
    bench.command("grasps")(bench_grasps)
    app.add_typer(bench, name="bench")
