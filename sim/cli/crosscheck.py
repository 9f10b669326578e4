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

TOLERANCES, READER_PANEL = "Tolerances", "Pinocchio's own reader"
"""Groups of options in the help."""


@errors_for_people()
def crosscheck(
    model: Annotated[
        str, typer.Argument(help="MJCF or URDF file, or a hand's name.", metavar="MODEL")
    ],
    against: Annotated[
        str | None,
        typer.Option(help="Another model, compared part by part.", metavar="MODEL"),
    ] = None,
    same: Annotated[
        list[str] | None,
        typer.Option(help="MINE=OTHER: a part's name there; repeatable.", metavar="NAMES"),
    ] = None,
    seed: SeedOption = 0,
    configurations: Annotated[
        int,
        typer.Option(min=1, help="Random configurations.", metavar="N"),
    ] = 20,
    kinematics: Annotated[
        float, typer.Option(help="Of poses, m and rad.", metavar="TOL", rich_help_panel=TOLERANCES)
    ] = 1e-10,
    dynamics: Annotated[
        float, typer.Option(help="Of forces, relative.", metavar="TOL", rich_help_panel=TOLERANCES)
    ] = 1e-9,
    parameters: Annotated[
        float,
        typer.Option(
            help="Of masses, limits, ..., relative.", metavar="TOL", rich_help_panel=TOLERANCES
        ),
    ] = 1e-9,
    distance: Annotated[
        float, typer.Option(help="Of distances, m.", metavar="TOL", rich_help_panel=TOLERANCES)
    ] = 2e-6,
    normal: Annotated[
        float, typer.Option(help="Of normals, rad.", metavar="TOL", rich_help_panel=TOLERANCES)
    ] = 1e-3,
    own_reader: Annotated[
        bool,
        typer.Option(
            help="Ask it too, in a child process.", metavar="", rich_help_panel=READER_PANEL
        ),
    ] = True,
    judge_reader: Annotated[
        bool,
        typer.Option(
            "--judge-reader",
            help="Its mistakes count too.",
            metavar="",
            rich_help_panel=READER_PANEL,
        ),
    ] = False,
    timeout: Annotated[
        float,
        typer.Option(min=0.1, help="Its time, s.", metavar="S", rich_help_panel=READER_PANEL),
    ] = 60.0,
    output: Annotated[Path | None, typer.Option("--out", "-o", help="Write JSON here.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Check a model: MuJoCo against Pinocchio, coal, another model.

    Exit code 0 if every judged quantity agrees, 1 if one differs, 3 on bad input: fit for a CI.
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
