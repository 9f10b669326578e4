"""The command that measures what physics does to grasps: ``bench physics``."""

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
from sim.cli.common import JsonOption, check_folder, errors_for_people, names


@errors_for_people()
def physics(
    hands: Annotated[list[str] | None, typer.Argument(help="Hands.", metavar="[HAND]...")] = None,
    objects: ObjectsOption = f"{PRIMITIVES},mug,lbracket,torus,hammer,superquadric,knot",
    parts: Annotated[
        str, typer.Option(help="Comma separated: holds, closed, remedies, creep.")
    ] = "holds,closed,remedies,creep",
    workers: WorkersOption = 1,
    samples: SamplesOption = Path("physics.jsonl"),
    output: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Measure physics: which default grasps hold under which preset, and how fast they creep.

    Both right hands of the project unless others are named. holds and closed: every preset, in the
    open and the closed loop. remedies: MuJoCo's defaults with one change each. creep: speed of the
    held object while one number changes, beside the formula of sim.creep.
    """
    from sim.bench.objects import bench_objects
    from sim.bench.physics import physics_tables, run_physics

    check_folder(samples)
    with measuring(output, workers) as runner:
        result = run_physics(
            hands or ["shadow_hand", "allegro_hand"],
            bench_objects(names(objects)),
            names(parts),
            file=samples,
            runner=runner,
        )
    give(result, output, as_json, lambda console: console.print(*physics_tables(result)))
