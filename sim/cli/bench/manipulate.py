"""The command that measures turns and translations in the hand: ``bench manipulate``."""

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
from sim.cli.common import (
    FingersOption,
    JsonOption,
    PhysicsOption,
    SeedOption,
    StandOption,
    check_folder,
    errors_for_people,
    names,
    physics_of,
)
from sim.cli.movement import NO_SHIFT, RotateOption, ShiftOption, movement


@errors_for_people()
def manipulate(
    hands: HandsArgument,
    objects: Annotated[
        str,
        typer.Option(
            help="Comma separated: cylinder, block, sphere, ellipsoid; superquadric or another "
            "mesh by name, as wide as those; mesh files, folders of them or sizes, as they are."
        ),
    ] = "cylinder",
    n: NumberOption = 50,
    height: HeightOption = 0.08,
    rotate: RotateOption = None,
    shift: ShiftOption = NO_SHIFT,
    fingers: FingersOption = None,
    stand: StandOption = 0.0,
    physics: PhysicsOption = "ours",
    seed: SeedOption = 0,
    workers: WorkersOption = 1,
    samples: SamplesOption = Path("manipulate.jsonl"),
    output: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Pick, turn or move in the hand, place: randomised trials, rates of success and closure.

    Friction is drawn, whatever --physics says.
    """
    from sim.bench.manipulate import run_manipulate
    from sim.bench.turn_table import manipulate_table

    axis, degrees, moved = movement(rotate, shift)
    computed = physics_of(physics)
    check_folder(samples)
    with measuring(output, workers) as runner:
        result = run_manipulate(
            hands,
            names(objects),
            n,
            height=height,
            fingers=None if fingers is None else tuple(names(fingers)),
            stand=stand,
            seed=seed,
            file=samples,
            runner=runner,
            axis=axis,
            angle=math.radians(degrees),
            shift=moved,
            physics=computed,
        )
    give(result, output, as_json, lambda console: console.print(manipulate_table(result)))
