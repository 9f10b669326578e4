"""The command ``bench best``."""

from __future__ import annotations

from typing import Annotated

import typer

from benchmarks.commands.common import HandsArgument, NumberOption, ObjectsOption, ResultOptions
from sim.cli.common import errors_for_people
from sim.cli.options import MuOption, ObjectiveOption, SeedOption, names, with_options


@errors_for_people()
@with_options
def best(
    hands: HandsArgument,
    objects: ObjectsOption = "sphere,box,cylinder,capsule,ellipsoid,mug",
    n: NumberOption = 20,
    marks: Annotated[
        str, typer.Option(help="CPU seconds after which the best is noted, comma separated.")
    ] = "0.1,0.3,1,2.3",
    metric: ObjectiveOption = "epsilon",
    ways: Annotated[
        str, typer.Option(help="Searches, comma separated: rounds 0, rounds 4, rounds 8, climb.")
    ] = "all",
    mu: MuOption = 0.5,
    floating: Annotated[bool, typer.Option("--floating", help="No table.", metavar="")] = False,
    seed: SeedOption = 0,
    *,
    result: ResultOptions,
) -> None:
    """Measure the best grasp after so much CPU time, for several ways to search."""
    from benchmarks.best import WAYS, best_tables, run_best
    from benchmarks.objects import bench_objects
    from benchmarks.requests import Setting
    from planner.errors import NotFoundError, TaskError

    asked = WAYS if ways == "all" else tuple(names(ways))
    for way in asked:
        if way not in WAYS:
            raise NotFoundError("search", way, WAYS)
    try:
        seconds = [float(text) for text in names(marks)]
    except ValueError as error:
        raise TaskError(f"--marks {marks!r} holds something else than numbers") from error
    with result.measuring() as runner:
        measured = run_best(
            hands,
            bench_objects(names(objects)),
            n,
            marks=seconds,
            metric=metric,
            setting=Setting(mu=mu, floating=floating, seed=seed),
            runner=runner,
            ways=asked,
        )
    result.give(measured, best_tables)
