"""Commands that measure forces and control: ``bench forces`` and ``control``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sim.cli.bench.common import (
    PRIMITIVES,
    ObjectsOption,
    OutOption,
    SamplesOption,
    WorkersOption,
    give,
    measuring,
)
from sim.cli.common import JsonOption, SeedOption, check_folder, errors_for_people, names


@errors_for_people()
def forces(
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
def control(
    hands: Annotated[list[str] | None, typer.Argument(help="Hands.", metavar="[HAND]...")] = None,
    objects: ObjectsOption = f"{PRIMITIVES},mug,lbracket,torus,hammer,superquadric",
    n: Annotated[
        int | None, typer.Option("-n", "--number", min=1, help="Grasps of every part.")
    ] = None,
    parts: Annotated[
        str, typer.Option(help="Comma separated: fc, push, drift, slip, robust, rate, promise.")
    ] = "fc,push,drift,slip,robust,rate,promise",
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
