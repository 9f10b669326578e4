"""The command ``bench exports``."""

from __future__ import annotations

from typing import Annotated

import typer

from benchmarks.commands.common import BOTH_HANDS, BothHandsArgument, ObjectsOption, ResultOptions
from sim.cli.common import errors_for_people
from sim.cli.options import SeedOption, names, with_options


@errors_for_people()
@with_options
def exports(
    hands: BothHandsArgument = None,
    objects: ObjectsOption = "sphere,box,cylinder,mug,lbracket",
    n: Annotated[
        int, typer.Option("-n", "--number", min=1, help="Plans in all, spread evenly.")
    ] = 100,
    formats: Annotated[
        str, typer.Option(help="Formats, comma separated; all that are read and written.")
    ] = "all",
    seed: SeedOption = 0,
    *,
    result: ResultOptions,
) -> None:
    """Write plans in every format of other tools, read them again, and measure the errors.

    Both right hands of the project unless others are named.
    """
    from benchmarks.exports import export_tables, round_trip_formats, run_exports
    from benchmarks.objects import bench_objects
    from planner.errors import NotFoundError

    able = round_trip_formats()
    chosen = able if formats == "all" else tuple(names(formats))
    for name in chosen:
        if name not in able:
            raise NotFoundError("format that is read and written", name, able)
    with result.measuring() as runner:
        measured = run_exports(
            hands or BOTH_HANDS,
            bench_objects(names(objects)),
            n,
            formats=chosen,
            seed=seed,
            runner=runner,
        )
    result.give(measured, export_tables)
