"""Commands that measure grasps in trials: ``bench grasps`` and ``metrics``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sim.cli.bench.common import (
    PRIMITIVES,
    HandsArgument,
    ObjectsOption,
    OutOption,
    SamplesOption,
    WorkersOption,
    give,
    measuring,
)
from sim.cli.common import (
    JsonOption,
    PhysicsOption,
    SeedOption,
    SimMuOption,
    check_folder,
    errors_for_people,
    names,
    physics_of,
)


@errors_for_people()
def grasps(
    hands: Annotated[str, typer.Option(help="Hands, comma separated.")] = (
        "shadow_hand,allegro_hand"
    ),
    objects: ObjectsOption = PRIMITIVES,
    seeds: Annotated[int, typer.Option(min=1, help="Seeds per cell, from 0.")] = 10,
    sim_mu: SimMuOption = None,
    physics: PhysicsOption = "ours",
    workers: WorkersOption = 1,
    samples: SamplesOption = Path("grasps.jsonl"),
    output: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Plan and execute hands x objects x seeds; the table of the README."""
    from sim.bench.grasps import grasps_table, run_grasps
    from sim.bench.objects import bench_objects

    computed = physics_of(physics, sim_mu)
    check_folder(samples)
    with measuring(output, workers) as runner:
        result = run_grasps(
            names(hands),
            bench_objects(names(objects)),
            seeds,
            physics=computed,
            file=samples,
            runner=runner,
        )
    give(result, output, as_json, lambda console: console.print(grasps_table(result)))


@errors_for_people()
def metrics(
    hands: HandsArgument,
    objects: ObjectsOption = PRIMITIVES,
    n: Annotated[int, typer.Option("-n", "--number", min=1, help="Grasps in all.")] = 500,
    seed: SeedOption = 0,
    workers: WorkersOption = 1,
    samples: SamplesOption = Path("metrics.jsonl"),
    output: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Simulate grasps of mixed quality: which metric predicts success."""
    from sim.bench.metrics import metrics_table, run_metrics
    from sim.bench.objects import bench_objects

    check_folder(samples)
    with measuring(output, workers) as runner:
        result = run_metrics(
            hands, bench_objects(names(objects)), n, seed=seed, file=samples, runner=runner
        )
    give(result, output, as_json, lambda console: console.print(metrics_table(result)))
