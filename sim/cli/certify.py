"""The command ``certify``."""

from __future__ import annotations

from typing import Annotated

import typer
from rich.markup import escape

from sim.cli.common import (
    EXIT_NO,
    JsonOption,
    PlanArgument,
    SeedOption,
    errors_for_people,
    out,
    print_json,
    say,
)
from sim.cli.reading import one_plan


@errors_for_people()
def certify(
    plan_file: PlanArgument,
    width: Annotated[
        float, typer.Option(help="Relative width of an interval that is narrow enough.")
    ] = 0.01,
    max_points: Annotated[
        int, typer.Option(min=1, help="Points at which an interval stays as wide as it is.")
    ] = 300,
    edges: Annotated[
        int, typer.Option(min=3, help="Sides of the friction pyramids that decide closure.")
    ] = 8,
    samples: Annotated[
        int, typer.Option(min=0, help="Random errors of every kind to try within its promise.")
    ] = 0,
    seed: SeedOption = 0,
    as_json: JsonOption = False,
) -> None:
    """Prove which loads and which errors a plan withstands.

    Loads are those of the planned posture under the best control that the actuators allow.

    Exit code 0 if the grasp is closed and no sample contradicts a promise, else with 1.
    """
    from planner.certify import certify as prove

    certificate = prove(
        one_plan(plan_file),
        width=width,
        max_points=max_points,
        edges=edges,
        samples=samples,
        seed=seed,
    )
    if as_json:
        print_json(certificate.as_dict())
    else:
        say(out, escape(str(certificate)))
    if not certificate.closed or any(t.lost for t in certificate.tolerances):
        raise typer.Exit(EXIT_NO)
