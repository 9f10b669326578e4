"""The command that measures the planning of turns in the hand: ``bench motion``."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

from sim.cli.bench.common import (
    HandsArgument,
    HeightOption,
    NumberOption,
    OutOption,
    SamplesOption,
    WorkersOption,
    give,
    measuring,
)
from sim.cli.common import JsonOption, SeedOption, check_folder, errors_for_people, names


@errors_for_people()
def motion(
    hands: HandsArgument,
    objects: Annotated[
        str, typer.Option(help="Comma separated: cylinder, block, sphere, ellipsoid.")
    ] = "cylinder,block",
    n: NumberOption = 20,
    height: HeightOption = 0.08,
    rotate: Annotated[
        float, typer.Option(min=-170.0, max=170.0, help="Turn about the vertical, degrees.")
    ] = 90.0,
    seed: SeedOption = 0,
    workers: WorkersOption = 1,
    samples: SamplesOption = Path("motion.jsonl"),
    output: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Plan turns in the hand: CPU time, and how often one is found of those that there are."""
    from sim.bench.motion import motion_table, run_motion

    check_folder(samples)
    with measuring(output, workers) as runner:
        result = run_motion(
            hands,
            names(objects),
            n,
            height=height,
            angle=math.radians(rotate),
            seed=seed,
            file=samples,
            runner=runner,
        )
    give(result, output, as_json, lambda console: console.print(motion_table(result)))
