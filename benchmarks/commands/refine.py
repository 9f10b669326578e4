"""The command ``bench refine``."""

from __future__ import annotations

from typing import Annotated

import typer

from benchmarks.commands.common import (
    PRIMITIVES,
    HandsArgument,
    NumberOption,
    ObjectsOption,
    ResultOptions,
)
from sim.cli.common import errors_for_people
from sim.cli.options import SeedOption, names, numbers, with_options

MESHES = "lbracket,mug,torus,hammer,superquadric"

MOST = 6
"""Most amounts of one measurement."""


@errors_for_people()
@with_options
def refine(
    hands: HandsArgument,
    objects: ObjectsOption = f"{PRIMITIVES},{MESHES}",
    n: NumberOption = 50,
    shifts: Annotated[
        str, typer.Option(help="How far hands are moved, mm, comma separated.", metavar="MM")
    ] = "5,10,20",
    turns: Annotated[
        str, typer.Option(help="How much they are turned each time, rad.", metavar="RAD")
    ] = "0.1,0.2,0.3",
    checks: Annotated[
        int,
        typer.Option(min=0, help="Plans of each cell that get a second opinion.", metavar="N"),
    ] = 50,
    seed: SeedOption = 0,
    *,
    result: ResultOptions,
) -> None:
    """Perturb our own plans and refine them: share brought back, distance, CPU, truth."""
    from benchmarks.objects import bench_objects
    from benchmarks.refine import refine_tables, run_refine

    count = min(shifts.count(",") + 1, MOST)
    lengths, angles = numbers("--shifts", shifts, count), numbers("--turns", turns, count)
    with result.measuring() as runner:
        measured = run_refine(
            hands,
            bench_objects(names(objects)),
            n,
            levels=[(1e-3 * a, b) for a, b in zip(lengths, angles, strict=True)],
            checks=checks,
            seed=seed,
            runner=runner,
        )
    result.give(measured, refine_tables)
