"""The command ``bench reality``: the same trials under each reality, by each loop."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from benchmarks.commands.common import (
    BOTH_HANDS,
    BothHandsArgument,
    ResultOptions,
    SamplesOption,
)
from sim.cli.common import errors_for_people
from sim.cli.execution import reality_of
from sim.cli.options import SeedOption, names, with_options


@errors_for_people()
@with_options
def reality(
    hands: BothHandsArgument = None,
    n: Annotated[
        int,
        typer.Option("-n", "--number", min=1, help="Trials for each hand, task, reality and loop."),
    ] = 10,
    tasks: Annotated[
        str, typer.Option(help="Comma separated: hold, turn, pushes (a minute each).")
    ] = "hold,turn",
    realities: Annotated[
        str, typer.Option(help="Comma separated: ideal, lab, rough, or TOML or JSON files.")
    ] = "ideal,lab,rough",
    loops: Annotated[
        str | None,
        typer.Option(
            help="Comma separated: truth, readings, estimates, touch, contact, open, blind, "
            "policy:FILE; the first six if not given."
        ),
    ] = None,
    objects: Annotated[
        str, typer.Option(help="Comma separated: those of the tasks' objects; all if not given.")
    ] = "",
    seed: SeedOption = 0,
    samples: SamplesOption = Path("reality.jsonl"),
    *,
    result: ResultOptions,
) -> None:
    """Compare loops under errors: the same trials with truth, readings, estimates, open loop.

    Both right hands of the project unless others are named. The same file goes on with more trials,
    hands, tasks, realities or loops.
    """
    from benchmarks.reality import LOOPS, reality_tables, run_reality

    usual = [name for name, loop in LOOPS.items() if loop.usual and not loop.why_not()]
    with result.measuring(samples) as runner:
        measured = run_reality(
            hands or BOTH_HANDS,
            n,
            tasks=names(tasks),
            realities=[reality_of(name) for name in names(realities)],
            loops=usual if loops is None else names(loops),
            objects=names(objects) if objects else (),
            seed=seed,
            file=samples,
            runner=runner,
        )
    result.give(measured, reality_tables)
