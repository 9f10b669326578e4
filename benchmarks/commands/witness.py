"""The command ``bench witness``."""

from __future__ import annotations

from benchmarks.commands.common import (
    BOTH_HANDS,
    PRIMITIVES,
    BothHandsArgument,
    NumberOption,
    ObjectsOption,
    ResultOptions,
)
from sim.cli.common import errors_for_people
from sim.cli.execution import physics_of
from sim.cli.options import PhysicsOption, SeedOption, SimMuOption, names, with_options


@errors_for_people()
@with_options
def witness(
    hands: BothHandsArgument = None,
    objects: ObjectsOption = PRIMITIVES,
    n: NumberOption = 10,
    seed: SeedOption = 0,
    sim_mu: SimMuOption = None,
    physics: PhysicsOption = "ours",
    *,
    result: ResultOptions,
) -> None:
    """Hold exported grasps in MuJoCo and in Drake: held here, there, in both.

    Of --physics Drake takes the friction alone.
    """
    from benchmarks.objects import bench_objects
    from benchmarks.witness import run_witness, witness_tables

    computed = physics_of(physics, sim_mu)
    with result.measuring() as runner:
        measured = run_witness(
            hands or BOTH_HANDS,
            bench_objects(names(objects)),
            n,
            seed=seed,
            physics=computed,
            runner=runner,
        )
    result.give(measured, witness_tables)
