"""The command ``bench audit``: known faults are found, none is invented."""

from __future__ import annotations

from typing import Annotated

import typer

from benchmarks.commands.common import (
    BOTH_HANDS,
    BothHandsArgument,
    NumberOption,
    ObjectsOption,
    ResultOptions,
)
from sim.cli.common import errors_for_people
from sim.cli.options import SeedOption, names, with_options


@errors_for_people()
@with_options
def audit(
    hands: BothHandsArgument = None,
    objects: ObjectsOption = "sphere,box,cylinder,capsule,mug",
    n: NumberOption = 10,
    faulty: Annotated[int, typer.Option(min=0, help="How many of them get each fault.")] = 10,
    timed: Annotated[
        int, typer.Option(min=1, help="Verdicts timed for each hand and object.")
    ] = 100,
    seed: SeedOption = 0,
    *,
    result: ResultOptions,
) -> None:
    """Judge good grasps and known faults as those of a foreign file: found, invented, time."""
    from benchmarks.audit import audit_tables, run_audit
    from benchmarks.objects import bench_objects

    with result.measuring() as runner:
        measured = run_audit(
            BOTH_HANDS if hands is None else hands,
            bench_objects(names(objects)),
            n,
            faulty=faulty,
            timed=timed,
            seed=seed,
            runner=runner,
        )
    result.give(measured, audit_tables)
