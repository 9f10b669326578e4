"""Commands that measure forces, control and physics: ``bench forces``, ``control``, ``physics``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from benchmarks.commands.common import (
    BOTH_HANDS,
    PRIMITIVES,
    BothHandsArgument,
    ObjectsOption,
    ResultOptions,
    SamplesOption,
)
from sim.cli.common import errors_for_people
from sim.cli.execution import reality_of
from sim.cli.options import RealityOption, SeedOption, names, with_options

SHAPES = f"{PRIMITIVES},mug,lbracket,torus,hammer,superquadric"


@errors_for_people()
@with_options
def forces(
    n: Annotated[int, typer.Option("-n", "--number", min=1, help="Programmes.")] = 1000,
    seed: SeedOption = 0,
    *,
    result: ResultOptions,
) -> None:
    """Check random force programmes: pyramids and cones, proofs, every solver (needs clarabel)."""
    from benchmarks.forces import force_tables, run_forces

    with result.measuring() as runner:
        measured = run_forces(n, seed=seed, runner=runner)
    result.give(measured, force_tables)


@errors_for_people()
@with_options
def control(
    hands: BothHandsArgument = None,
    objects: ObjectsOption = SHAPES,
    n: Annotated[
        int | None, typer.Option("-n", "--number", min=1, help="Grasps of every part.")
    ] = None,
    parts: Annotated[
        str, typer.Option(help="Comma separated: fc, push, drift, slip, robust, rate, promise.")
    ] = "fc,push,drift,slip,robust,rate,promise",
    reality: RealityOption = "ideal",
    seed: SeedOption = 0,
    samples: SamplesOption = Path("control.jsonl"),
    *,
    result: ResultOptions,
) -> None:
    """Measure control: what grasps bear in either loop, how they drift, slips that are noticed.

    Both hands of the project unless others are named. Without -n every part has as many grasps as
    its figure asks for. The same file goes on with more grasps or other parts.
    """
    from benchmarks.control import control_tables, grasps_of, run_control
    from benchmarks.objects import bench_objects

    errors = reality_of(reality)
    with result.measuring(samples) as runner:
        measured = run_control(
            hands or BOTH_HANDS,
            bench_objects(names(objects)),
            grasps_of(names(parts), n),
            seed=seed,
            file=samples,
            runner=runner,
            reality=errors,
        )
    result.give(measured, control_tables)


@errors_for_people()
@with_options
def physics(
    hands: BothHandsArgument = None,
    objects: ObjectsOption = f"{SHAPES},knot",
    parts: Annotated[
        str, typer.Option(help="Comma separated: holds, closed, remedies, creep.")
    ] = "holds,closed,remedies,creep",
    reality: RealityOption = "ideal",
    samples: SamplesOption = Path("physics.jsonl"),
    *,
    result: ResultOptions,
) -> None:
    """Measure physics: which default grasps hold under which preset, and how fast they creep.

    Both right hands of the project unless others are named. holds and closed: every preset, in the
    open and the closed loop. remedies: MuJoCo's defaults with one change each. creep: speed of the
    held object while one number changes, beside the formula of sim.creep.
    """
    from benchmarks.objects import bench_objects
    from benchmarks.physics import physics_tables, run_physics

    errors = reality_of(reality)
    with result.measuring(samples) as runner:
        measured = run_physics(
            hands or BOTH_HANDS,
            bench_objects(names(objects)),
            names(parts),
            file=samples,
            runner=runner,
            reality=errors,
        )
    result.give(measured, physics_tables)
