"""The command ``bench witness``."""

from __future__ import annotations

from sim.cli.bench.common import (
    BOTH_HANDS,
    PRIMITIVES,
    BothHandsArgument,
    NumberOption,
    ObjectsOption,
    ResultOptions,
)
from sim.cli.common import SeedOption, errors_for_people, names
from sim.cli.options import with_options


@errors_for_people()
@with_options
def witness(
    hands: BothHandsArgument = None,
    objects: ObjectsOption = PRIMITIVES,
    n: NumberOption = 10,
    seed: SeedOption = 0,
    *,
    result: ResultOptions,
) -> None:
    """Hold exported grasps in MuJoCo and in Drake: held there, here, in both."""
    from sim.bench.objects import bench_objects
    from sim.bench.witness import run_witness, witness_tables

    with result.measuring() as runner:
        measured = run_witness(
            hands or BOTH_HANDS, bench_objects(names(objects)), n, seed=seed, runner=runner
        )
    result.give(measured, witness_tables)
