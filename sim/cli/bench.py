"""Commands that measure: ``bench grasps``, ``synthesis``, ``control``, and others."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console

from sim.cli.common import (
    EXIT_INTERRUPTED,
    AttemptsOption,
    FingersOption,
    JsonOption,
    MuOption,
    RoundsOption,
    SeedOption,
    SimMuOption,
    check_folder,
    err,
    errors_for_people,
    heeding_ctrl_c,
    names,
    out,
    print_json,
)

if TYPE_CHECKING:
    from sim.runner import Runner

TABLE_WIDTH = 140
"""Characters that the benchmark's tables need at least."""

HandsArgument = Annotated[
    list[str], typer.Argument(help="Names or paths of hands.", metavar="HAND...")
]
ObjectsOption = Annotated[
    str,
    typer.Option(help="Objects, comma separated; a folder stands for the mesh files in it."),
]
OutOption = Annotated[Path | None, typer.Option("--out", help="Write JSON here.")]
SamplesOption = Annotated[
    Path, typer.Option(help="Results go here as they come; goes on where it ended.")
]
WorkersOption = Annotated[int, typer.Option(min=1, help="Processes.")]
PRIMITIVES = "sphere,box,cylinder,capsule,ellipsoid"


@errors_for_people()
def bench_grasps(
    hands: Annotated[str, typer.Option(help="Hands, comma separated.")] = (
        "shadow_hand,allegro_hand"
    ),
    objects: ObjectsOption = PRIMITIVES,
    seeds: Annotated[int, typer.Option(min=1, help="Seeds per cell, from 0.")] = 10,
    sim_mu: SimMuOption = 0.6,
    workers: WorkersOption = 1,
    samples: SamplesOption = Path("grasps.jsonl"),
    output: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Plan and execute hands x objects x seeds; the table of the README."""
    from sim.bench.grasps import grasps_table, run_grasps
    from sim.bench.objects import bench_objects

    check_folder(samples)
    with measuring(output, workers) as runner:
        result = run_grasps(
            names(hands),
            bench_objects(names(objects)),
            seeds,
            mu=sim_mu,
            file=samples,
            runner=runner,
        )
    give(result, output, as_json, lambda console: console.print(grasps_table(result)))


@errors_for_people()
def bench_synthesis(
    hands: HandsArgument,
    objects: ObjectsOption = PRIMITIVES,
    n: Annotated[int, typer.Option("-n", "--number", min=1, help="Requests per cell.")] = 50,
    seed: SeedOption = 0,
    mu: MuOption = 0.5,
    fingers: FingersOption = None,
    floating: Annotated[bool, typer.Option("--floating/--table", help="Without a table.")] = False,
    clearance: Annotated[
        float, typer.Option(min=0, help="Least distance of what must not touch, m.")
    ] = 0.0,
    rounds: RoundsOption = None,
    max_attempts: AttemptsOption = 100,
    workers: WorkersOption = 1,
    baseline: Annotated[
        bool, typer.Option("--baseline", help="Compare with FRoGGeR's figures.")
    ] = False,
    output: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Measure planning: found per CPU second, CPU by stage, epsilon, diversity."""
    from sim.bench.objects import bench_objects
    from sim.bench.requests import Setting
    from sim.bench.synthesis import run_synthesis
    from sim.bench.tables import print_synthesis

    setting = Setting(
        mu=mu,
        fingers=None if fingers is None else tuple(names(fingers)),
        floating=floating,
        clearance=clearance,
        rounds=rounds,
        max_attempts=max_attempts,
        seed=seed,
    )
    with measuring(output, workers) as runner:
        result = run_synthesis(
            hands, bench_objects(names(objects)), n, setting, runner=runner, baseline=baseline
        )
    give(result, output, as_json, lambda console: print_synthesis(result, console))


@errors_for_people()
def bench_objectives(
    hands: HandsArgument,
    objects: ObjectsOption = "cylinder,box,mug",
    n: Annotated[int, typer.Option("-n", "--number", min=1, help="Requests per cell.")] = 15,
    objectives: Annotated[
        str,
        typer.Option(
            help="Objectives, comma separated; of several with weights: a:1+b:0.5; all stands for "
            "none and each alone."
        ),
    ] = "all",
    seed: SeedOption = 0,
    max_attempts: AttemptsOption = 50,
    workers: WorkersOption = 1,
    output: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Measure what each objective of synthesis brings, and what it costs."""
    from planner.synthesis import OBJECTIVES
    from planner.synthesis.options import NO_OBJECTIVE
    from sim.bench.objectives import objective_tables, run_objectives
    from sim.bench.objects import bench_objects

    every = [NO_OBJECTIVE, *OBJECTIVES]
    asked = every if objectives == "all" else names(objectives)
    with measuring(output, workers) as runner:
        result = run_objectives(
            hands,
            bench_objects(names(objects)),
            n,
            objectives=[text.replace("+", ",") for text in asked],
            seed=seed,
            max_attempts=max_attempts,
            runner=runner,
        )
    give(result, output, as_json, lambda console: console.print(*objective_tables(result)))


@errors_for_people()
def bench_metrics(
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


@errors_for_people()
def bench_scaling(
    hand: Annotated[str, typer.Option(help="Name or path of a hand.")] = "allegro_hand",
    curves: Annotated[
        str, typer.Option(help="Comma separated: grasps, workers, contacts, triangles.")
    ] = "grasps,workers,contacts,triangles",
    n: Annotated[int, typer.Option("-n", "--number", min=1, help="Requests per point.")] = 20,
    most_grasps: Annotated[int, typer.Option(min=2, help="Where the curve of grasps ends.")] = 1000,
    output: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Measure how cost grows: with grasps, workers, contacts and triangles."""
    from sim.bench.scaling import run_scaling, scaling_tables

    with measuring(output, workers=1) as runner:
        result = run_scaling(hand, names(curves), n, most_grasps=most_grasps, runner=runner)
    give(result, output, as_json, lambda console: console.print(*scaling_tables(result)))


@errors_for_people()
def bench_forces(
    n: Annotated[int, typer.Option("-n", "--number", min=1, help="Programmes.")] = 1000,
    seed: SeedOption = 0,
    workers: WorkersOption = 1,
    output: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Check random force programmes: pyramids and cones, proofs, every solver (needs clarabel)."""
    from sim.bench.forces import force_tables, run_forces

    with measuring(output, workers) as runner:
        result = run_forces(n, seed=seed, runner=runner)
    give(result, output, as_json, lambda console: console.print(*force_tables(result)))


@errors_for_people()
def bench_control(
    hands: Annotated[list[str] | None, typer.Argument(help="Hands.", metavar="[HAND]...")] = None,
    objects: ObjectsOption = f"{PRIMITIVES},mug,lbracket,torus,hammer,superquadric",
    n: Annotated[
        int | None, typer.Option("-n", "--number", min=1, help="Grasps of every part.")
    ] = None,
    parts: Annotated[
        str, typer.Option(help="Comma separated: fc, push, drift, slip, robust, rate.")
    ] = "fc,push,drift,slip,robust,rate",
    seed: SeedOption = 0,
    workers: WorkersOption = 1,
    samples: SamplesOption = Path("control.jsonl"),
    output: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Measure control: what grasps bear in either loop, how they drift, slips that are noticed.

    Both hands of the project unless others are named. Without -n every part has as many grasps as
    its figure asks for. The same file goes on with more grasps or other parts.
    """
    from sim.bench.control import control_tables, grasps_of, run_control
    from sim.bench.objects import bench_objects

    check_folder(samples)
    with measuring(output, workers) as runner:
        result = run_control(
            hands or ["shadow_hand", "allegro_hand"],
            bench_objects(names(objects)),
            grasps_of(names(parts), n),
            seed=seed,
            file=samples,
            runner=runner,
        )
    give(result, output, as_json, lambda console: console.print(*control_tables(result)))


@errors_for_people()
def bench_manipulate(
    hands: HandsArgument,
    objects: Annotated[
        str, typer.Option(help="Comma separated: cylinder, block, sphere, ellipsoid.")
    ] = "cylinder",
    n: Annotated[int, typer.Option("-n", "--number", min=1, help="Trials per cell.")] = 50,
    height: Annotated[
        float, typer.Option(min=0.04, help="Height of cylinder, block and ellipsoid, m.")
    ] = 0.08,
    fingers: FingersOption = None,
    seed: SeedOption = 0,
    workers: WorkersOption = 1,
    samples: SamplesOption = Path("manipulate.jsonl"),
    output: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Pick, turn by 90 degrees in the hand, place: randomised trials, strict and loose rates."""
    from sim.bench.manipulate import manipulate_table, run_manipulate

    check_folder(samples)
    with measuring(output, workers) as runner:
        result = run_manipulate(
            hands,
            names(objects),
            n,
            height=height,
            fingers=None if fingers is None else tuple(names(fingers)),
            seed=seed,
            file=samples,
            runner=runner,
        )
    give(result, output, as_json, lambda console: console.print(manipulate_table(result)))


@contextmanager
def measuring(output: Path | None, workers: int) -> Iterator[Runner]:
    """Who works on a measurement: shows how far it is on stderr, and heeds Ctrl-C and SIGTERM."""
    from sim.runner import Runner

    check_folder(output)
    with heeding_ctrl_c() as check:
        yield Runner(console=err, check=check, workers=workers)


def give(
    result: dict[str, Any], output: Path | None, as_json: bool, show: Callable[[Console], None]
) -> None:
    """Write and print a result; exit as interrupted if it was.

    Args:
        result: Of a measurement.
        output: Where it is written, if anywhere.
        as_json: Whether it is printed as it is, and not shown.
        show: Shows it on a console where the tables fit; a narrow terminal breaks their lines.
    """
    from planner.files import write_json

    if output is not None:
        write_json(result, output)
    if as_json:
        print_json(result)
    else:
        show(Console(width=max(out.width, TABLE_WIDTH)))
    if result["interrupted"]:
        raise typer.Exit(EXIT_INTERRUPTED)


def register(app: typer.Typer) -> None:
    """Add the group ``bench``."""
    bench = typer.Typer(
        help="Measure: tables that repeat the project's figures.", no_args_is_help=True
    )
    bench.command("grasps")(bench_grasps)
    bench.command("synthesis")(bench_synthesis)
    bench.command("objectives")(bench_objectives)
    bench.command("metrics")(bench_metrics)
    bench.command("scaling")(bench_scaling)
    bench.command("forces")(bench_forces)
    bench.command("control")(bench_control)
    bench.command("manipulate")(bench_manipulate)
    app.add_typer(bench, name="bench")
