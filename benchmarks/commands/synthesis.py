"""Commands that measure planning: ``bench synthesis``, ``objectives`` and ``scaling``."""

from __future__ import annotations

from pathlib import Path
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
from sim.cli.options import (
    AttemptsOption,
    FingersOption,
    JsonOption,
    MuOption,
    RoundsOption,
    SeedOption,
    names,
    with_options,
)


@errors_for_people()
@with_options
def synthesis(
    hands: HandsArgument,
    objects: ObjectsOption = PRIMITIVES,
    n: NumberOption = 50,
    seed: SeedOption = 0,
    mu: MuOption = 0.5,
    fingers: FingersOption = None,
    floating: Annotated[
        bool, typer.Option("--floating/--table", help="Without a table.", metavar="")
    ] = False,
    clearance: Annotated[
        float, typer.Option(min=0, help="Least distance of what must not touch, m.")
    ] = 0.0,
    rounds: RoundsOption = None,
    max_attempts: AttemptsOption = 100,
    baseline: Annotated[
        bool, typer.Option("--baseline", help="Compare with FRoGGeR's figures.", metavar="")
    ] = False,
    *,
    result: ResultOptions,
) -> None:
    """Measure planning: found per CPU second, CPU by stage, epsilon, diversity."""
    from benchmarks.objects import bench_objects
    from benchmarks.requests import Setting
    from benchmarks.synthesis import run_synthesis
    from benchmarks.synthesis_tables import synthesis_tables

    setting = Setting(
        mu=mu,
        fingers=None if fingers is None else tuple(names(fingers)),
        floating=floating,
        clearance=clearance,
        rounds=rounds,
        max_attempts=max_attempts,
        seed=seed,
    )
    with result.measuring() as runner:
        measured = run_synthesis(
            hands,
            bench_objects(names(objects)),
            n,
            setting,
            runner=runner,
            baseline=baseline,
            first=True,
        )
    result.give(measured, synthesis_tables)


@errors_for_people()
@with_options
def objectives(
    hands: HandsArgument,
    objects: ObjectsOption = "cylinder,box,mug",
    n: NumberOption = 15,
    objectives: Annotated[
        str,
        typer.Option(
            help="Objectives, comma separated; of several with weights: a:1+b:0.5; all stands for "
            "none and each alone."
        ),
    ] = "all",
    seed: SeedOption = 0,
    max_attempts: AttemptsOption = 50,
    *,
    result: ResultOptions,
) -> None:
    """Measure what each objective of synthesis brings, and what it costs."""
    from benchmarks.objectives import objective_tables, run_objectives
    from benchmarks.objects import bench_objects
    from planner.synthesis import OBJECTIVES
    from planner.synthesis.options import NO_OBJECTIVE

    every = [NO_OBJECTIVE, *OBJECTIVES]
    asked = every if objectives == "all" else names(objectives)
    with result.measuring() as runner:
        measured = run_objectives(
            hands,
            bench_objects(names(objects)),
            n,
            objectives=[text.replace("+", ",") for text in asked],
            seed=seed,
            max_attempts=max_attempts,
            runner=runner,
        )
    result.give(measured, objective_tables)


@errors_for_people()
def scaling(
    hand: Annotated[str, typer.Option(help="Name or path of a hand.")] = "allegro_hand",
    curves: Annotated[
        str, typer.Option(help="Comma separated: grasps, workers, contacts, triangles.")
    ] = "grasps,workers,contacts,triangles",
    n: Annotated[int, typer.Option("-n", "--number", min=1, help="Requests per point.")] = 20,
    most_grasps: Annotated[int, typer.Option(min=2, help="Where the curve of grasps ends.")] = 1000,
    output: Annotated[Path | None, typer.Option("--out", help="Write JSON here.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Measure how cost grows: with grasps, workers, contacts and triangles."""
    from benchmarks.scaling import run_scaling, scaling_tables

    result = ResultOptions(output=output, as_json=as_json)  # in this process
    with result.measuring() as runner:
        measured = run_scaling(hand, names(curves), n, most_grasps=most_grasps, runner=runner)
    result.give(measured, scaling_tables)
