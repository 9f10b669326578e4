"""Commands that measure grasps in trials: ``bench grasps``, ``walls``, ``metrics``, ``trials``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from benchmarks.commands.common import (
    BOTH_HANDS,
    PRIMITIVES,
    BothHandsArgument,
    HandsArgument,
    NumberOption,
    ObjectsOption,
    ResultOptions,
    SamplesOption,
)
from sim.cli.common import errors_for_people
from sim.cli.execution import physics_of, reality_of
from sim.cli.options import (
    PhysicsOption,
    RealityOption,
    SeedOption,
    SimMuOption,
    names,
    with_options,
)


@errors_for_people()
@with_options
def grasps(
    hands: Annotated[str, typer.Option(help="Hands, comma separated.")] = (
        "shadow_hand,allegro_hand"
    ),
    objects: ObjectsOption = PRIMITIVES,
    seeds: Annotated[int, typer.Option(min=1, help="Seeds per cell, from 0.")] = 10,
    sim_mu: SimMuOption = None,
    physics: PhysicsOption = "ours",
    reality: RealityOption = "ideal",
    samples: SamplesOption = Path("grasps.jsonl"),
    *,
    result: ResultOptions,
) -> None:
    """Plan and execute hands x objects x seeds; the table of the README."""
    from benchmarks.grasps import grasps_table, run_grasps
    from benchmarks.objects import bench_objects

    computed, errors = physics_of(physics, sim_mu), reality_of(reality)
    with result.measuring(samples) as runner:
        measured = run_grasps(
            names(hands),
            bench_objects(names(objects)),
            seeds,
            physics=computed,
            reality=errors,
            file=samples,
            runner=runner,
        )
    result.give(measured, grasps_table)


@errors_for_people()
@with_options
def walls(
    hands: BothHandsArgument = None,
    objects: Annotated[
        str | None,
        typer.Option(help="Objects, comma separated; eight cups, mugs and bowls if not given."),
    ] = None,
    n: NumberOption = 10,
    trials: Annotated[
        int, typer.Option(min=0, help="How many of them are executed in simulation.")
    ] = 2,
    reality: RealityOption = "ideal",
    seed: SeedOption = 0,
    *,
    result: ResultOptions,
) -> None:
    """Grasp cups, mugs and bowls of thin walls: found within 1 s, rate, held."""
    from benchmarks.objects import bench_objects
    from benchmarks.walls import WALLED, run_walls, walls_tables

    chosen = WALLED if objects is None else names(objects)
    errors = reality_of(reality)
    with result.measuring() as runner:
        measured = run_walls(
            hands or BOTH_HANDS,
            bench_objects(chosen),
            n,
            trials,
            seed=seed,
            runner=runner,
            reality=errors,
        )
    result.give(measured, walls_tables)


@errors_for_people()
@with_options
def metrics(
    hands: HandsArgument,
    objects: ObjectsOption = PRIMITIVES,
    n: Annotated[int, typer.Option("-n", "--number", min=1, help="Grasps in all.")] = 500,
    reality: RealityOption = "ideal",
    seed: SeedOption = 0,
    samples: SamplesOption = Path("metrics.jsonl"),
    *,
    result: ResultOptions,
) -> None:
    """Simulate grasps of mixed quality: which metric predicts success."""
    from benchmarks.metrics import metrics_table, run_metrics
    from benchmarks.objects import bench_objects

    errors = reality_of(reality)
    with result.measuring(samples) as runner:
        measured = run_metrics(
            hands,
            bench_objects(names(objects)),
            n,
            seed=seed,
            file=samples,
            runner=runner,
            reality=errors,
        )
    result.give(measured, metrics_table)


@errors_for_people()
@with_options
def trials(
    hands: BothHandsArgument = None,
    objects: ObjectsOption = "sphere,box,cylinder",
    controllers: Annotated[
        str, typer.Option(help="Controllers, comma separated.")
    ] = "feedforward,impedance",
    repeats: Annotated[int, typer.Option(min=1, help="Timings per cell; medians count.")] = 3,
    reality: RealityOption = "ideal",
    seed: SeedOption = 0,
    *,
    result: ResultOptions,
) -> None:
    """Time trials: CPU beside MuJoCo's steps alone with the same commands."""
    from benchmarks.objects import bench_objects
    from benchmarks.trial_cost import run_trial_cost, trial_cost_table

    errors = reality_of(reality)
    with result.measuring() as runner:
        measured = run_trial_cost(
            hands or BOTH_HANDS,
            bench_objects(names(objects)),
            names(controllers),
            seed=seed,
            repeats=repeats,
            runner=runner,
            reality=errors,
        )
    result.give(measured, trial_cost_table)
