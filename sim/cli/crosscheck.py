"""The command ``crosscheck``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

from sim.cli.common import (
    EXIT_NO,
    JsonOption,
    SeedOption,
    check_folder,
    errors_for_people,
    out,
    print_json,
    say,
)


@errors_for_people()
def crosscheck(
    model: Annotated[
        str,
        typer.Argument(help="MJCF or URDF file, or a hand by name.", metavar="MODEL"),
    ],
    against: Annotated[
        str | None,
        typer.Option(help="Compare with this model instead, part by part: a URDF with an MJCF."),
    ] = None,
    same: Annotated[
        list[str] | None,
        typer.Option(help="REFERENCE=OTHER: a part that has another name there; repeatable."),
    ] = None,
    seed: SeedOption = 0,
    configurations: Annotated[int, typer.Option(min=1, help="Random configurations.")] = 20,
    kinematics: Annotated[float, typer.Option(help="Tolerance of poses, m and rad.")] = 1e-10,
    dynamics: Annotated[float, typer.Option(help="Tolerance of forces, relative.")] = 1e-9,
    parameters: Annotated[
        float, typer.Option(help="Tolerance of masses, limits, ..., relative.")
    ] = 1e-9,
    distance: Annotated[float, typer.Option(help="Tolerance of distances, m.")] = 2e-6,
    normal: Annotated[float, typer.Option(help="Tolerance of their directions, rad.")] = 1e-3,
    own_reader: Annotated[
        bool, typer.Option(help="Ask Pinocchio's own reader too, in a child process.")
    ] = True,
    judge_reader: Annotated[
        bool, typer.Option("--judge-reader", help="Its mistakes count for the exit code.")
    ] = False,
    timeout: Annotated[float, typer.Option(min=0.1, help="Seconds for that reader.")] = 60.0,
    output: Annotated[Path | None, typer.Option("--out", "-o", help="Write JSON here.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Check a model in MuJoCo against Pinocchio and coal, or against another model.

    Ends with 0 if every judged quantity agrees, 1 if one differs, 3 on bad input: fit for a CI.
    """
    from planner.files import write_json
    from sim.crosscheck import Tolerances, compare_models, crosscheck_tables
    from sim.crosscheck import crosscheck as check

    check_folder(output)
    tolerances = Tolerances(
        kinematics=kinematics,
        dynamics=dynamics,
        parameters=parameters,
        distance=distance,
        normal=normal,
    )
    pairs = _pairs(same or [], against)
    if against is None:
        report = check(
            model,
            seed=seed,
            n_configurations=configurations,
            tolerances=tolerances,
            own_reader=own_reader,
            judge_reader=judge_reader,
            timeout=timeout,
        )
    else:
        report = compare_models(
            model,
            against,
            names=pairs,
            seed=seed,
            n_configurations=configurations,
            tolerances=tolerances,
        )
    if output is not None:
        write_json(report.to_dict(), output)
    if as_json:
        print_json(report.to_dict())
    else:
        for table in crosscheck_tables(report):
            out.print(table)
        for column in report.columns:
            if column.failure:
                say(out, f"[red]{escape(column.name)}:[/] {escape(column.failure)}")
            for note in column.notes:
                say(out, escape(f"{column.name}: {note}"))
        for note in report.notes:
            say(out, escape(note))
        missing = [c.name for c in report.columns if c.failure and not c.judged]
        without = f", without {escape(' and '.join(missing))}" if missing else ""
        agree = f"[green]all judged quantities agree[/]{without}"
        say(out, agree if report.ok else "[red]differs[/]")
    if not report.ok:
        raise typer.Exit(EXIT_NO)


def _pairs(same: list[str], against: str | None) -> dict[str, str]:
    """Names of the reference -> names of the other model."""
    from planner.errors import TaskError

    wrong = [pair for pair in same if pair.count("=") != 1]
    if wrong or (same and against is None):
        raise TaskError(
            f"--same {(wrong or same)[0]!r}: give REFERENCE=OTHER, together with --against"
        )
    split = (pair.partition("=") for pair in same)
    return {reference.strip(): other.strip() for reference, _, other in split}


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(crosscheck)
