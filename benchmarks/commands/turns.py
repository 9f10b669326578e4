"""Commands that measure turns in the hand: planned (``bench motion``), made (``manipulate``)."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

from benchmarks.commands.common import (
    HandsArgument,
    HeightOption,
    NumberOption,
    ResultOptions,
    SamplesOption,
)
from sim.cli.common import errors_for_people
from sim.cli.execution import estimate_of, physics_of, reality_of
from sim.cli.options import (
    NO_SHIFT,
    EstimateOption,
    FingersOption,
    PhysicsOption,
    RealityOption,
    RotateOption,
    SeedOption,
    ShiftOption,
    StandOption,
    movement,
    names,
    with_options,
)


@errors_for_people()
@with_options
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
    samples: SamplesOption = Path("motion.jsonl"),
    *,
    result: ResultOptions,
) -> None:
    """Plan turns in the hand: CPU time, and how often one is found of those that there are."""
    from benchmarks.motion import motion_table, run_motion

    with result.measuring(samples) as runner:
        measured = run_motion(
            hands,
            names(objects),
            n,
            height=height,
            angle=math.radians(rotate),
            seed=seed,
            file=samples,
            runner=runner,
        )
    result.give(measured, motion_table)


@errors_for_people()
@with_options
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
    reality: RealityOption = "ideal",
    estimate: EstimateOption = None,
    controller: Annotated[
        str,
        typer.Option(
            help="feedforward, impedance, or policy:FILE; the closed loop if not given.",
            metavar="NAME",
        ),
    ] = "",
    seed: SeedOption = 0,
    samples: SamplesOption = Path("manipulate.jsonl"),
    *,
    result: ResultOptions,
) -> None:
    """Pick, turn or move in the hand, place: randomised trials, rates of success and closure.

    Friction is drawn, whatever --physics says.
    """
    from benchmarks.manipulate import run_manipulate
    from benchmarks.turn_table import manipulate_table

    axis, degrees, moved = movement(rotate, shift)
    computed, errors = physics_of(physics), reality_of(reality)
    estimator = estimate_of(estimate)
    with result.measuring(samples) as runner:
        measured = run_manipulate(
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
            reality=errors,
            estimator=estimator,
            controller=controller,
        )
    result.give(measured, manipulate_table)
