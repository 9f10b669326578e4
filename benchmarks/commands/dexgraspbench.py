"""The command ``bench dexgraspbench``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

from benchmarks.commands.common import ResultOptions
from sim.cli.common import err, errors_for_people, out, say
from sim.cli.options import names, with_options


@errors_for_people()
@with_options
def dexgraspbench(
    batches: Annotated[
        list[Path] | None,
        typer.Argument(help="Folders of batches; without one, only sets up.", metavar="[BATCH]..."),
    ] = None,
    benchmark: Annotated[
        str, typer.Option(help="Path or URL of DexGraspBench's git repository.")
    ] = "https://github.com/JYChen18/DexGraspBench",
    meshes: Annotated[
        str | None,
        typer.Option(help="Path or URL of MuJoCo Menagerie, for the benchmark's own hands."),
    ] = None,
    home: Annotated[
        Path, typer.Option(help="Folder for environment, checkout, export and results.")
    ] = Path("dexgraspbench"),
    settings: Annotated[
        str, typer.Option(help="The benchmark's settings, comma separated.")
    ] = "fc,tabletop",
    compare: Annotated[
        bool,
        typer.Option(
            help="Also judge every grasp by our own --protocol dexgraspbench.", metavar=""
        ),
    ] = True,
    *,
    result: ResultOptions,
) -> None:
    """Have DexGraspBench itself, in its pinned versions, evaluate batches of grasps."""
    from benchmarks.dexgraspbench import (
        HANDS,
        SETTINGS,
        dexgraspbench_table,
        install,
        run_dexgraspbench,
    )
    from planner.errors import NotFoundError

    chosen = names(settings)
    for name in chosen:
        if name not in SETTINGS:
            raise NotFoundError("setting of DexGraspBench", name, SETTINGS)
    with result.measuring() as runner:
        installed = install(home, benchmark, meshes)
        if not batches:
            for hand in HANDS:
                if hand not in installed.lacking:
                    say(out, escape(f"plan with: opposable batch {installed.hand_file(hand)} ..."))
            if installed.lacking:
                lacking = ", ".join(installed.lacking)
                say(out, escape(f"without meshes: {lacking}; give --meshes to plan with them"))
            return
        measured = run_dexgraspbench(
            installed, batches, home, settings=chosen, compare=compare, runner=runner
        )
    for name, export in measured["exports"].items():
        for reason, count in export["left_out"].items():
            say(err, escape(f"{name}: {count} grasps left out: {reason}"))
    result.give(measured, dexgraspbench_table)
