"""The command ``audit``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape

from sim.cli.common import (
    EXIT_INTERRUPTED,
    EXIT_NO,
    GRIP_PANEL,
    FingersOption,
    JsonOption,
    MuOption,
    check_folder,
    err,
    errors_for_people,
    keep_inputs,
    names,
    numbers,
    out,
    print_json,
    say,
)
from sim.cli.options import with_options
from sim.cli.reading import ReadingOptions, listed_plans, our_kind, refuse_beside_ours
from sim.progress import ProgressBar

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rich.table import Table

    from planner.audit import AuditReport, GraspFile
    from planner.hands.hand import Hand
    from planner.task import GraspTask

TABLE_WIDTH = 110
"""Width of the tables, characters."""

KEPT = ("file", "approach", "simulate", "workers", "output", "as_json")
"""Parameters that go with plans and batches of ours, which bring the rest."""

SHOWN = 10
"""Grasps that do not pass and are listed with their reasons."""


@errors_for_people()
@with_options
def audit(
    context: typer.Context,
    file: Annotated[
        Path,
        typer.Argument(help="Grasps; a plan, a folder of them, a batch.", metavar="FILE"),
    ],
    hand: Annotated[
        str | None,
        typer.Option(
            help="Name, hand.toml, MJCF, URDF; else that of FILE.",
            metavar="HAND",
        ),
    ] = None,
    object: Annotated[
        str | None,
        typer.Option(
            help="As `plan` does, at scale 1; else that of FILE.",
            metavar="OBJECT",
        ),
    ] = None,
    *,
    reading: ReadingOptions,
    fingers: FingersOption = None,
    mu: MuOption = 0.5,
    grip_force: Annotated[
        float | None,
        typer.Option(
            help="Least normal force of a finger, N.", metavar="N", rich_help_panel=GRIP_PANEL
        ),
    ] = None,
    mass: Annotated[
        float | None,
        typer.Option(help="Mass, kg; 0.1 if not given.", metavar="KG", rich_help_panel=GRIP_PANEL),
    ] = None,
    table: Annotated[
        str,
        typer.Option(
            help="Height of a table's top, m.",
            metavar="Z|none",
            rich_help_panel=GRIP_PANEL,
        ),
    ] = "none",
    gravity: Annotated[
        str, typer.Option(help="In m/s2, world.", metavar="X,Y,Z", rich_help_panel=GRIP_PANEL)
    ] = "0,0,-9.81",
    approach: Annotated[
        bool, typer.Option("--approach", help="Ask for a straight way in, too.", metavar="")
    ] = False,
    simulate: Annotated[
        bool,
        typer.Option(
            "--simulate",
            help="Execute every grasp, too.",
            metavar="",
        ),
    ] = False,
    workers: Annotated[int, typer.Option(help="Processes; -1 for one per core.", metavar="N")] = -1,
    output: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="Write the rows here: .csv or .parquet.", metavar="FILE"),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Judge grasps that somebody else made by the verdict on our own.

    Plans and batches of ours bring hand and object, and so may tables; other files need --hand and
    --object. Exit code 0 if every grasp passes, 1 if not.
    """
    from planner.audit.report import check_form
    from sim.cli.places import object_of, table_of

    check_folder(output)
    keep_inputs(output, file)
    if output is not None:
        check_form(output)
    ours = None if reading.format is not None else our_kind(file)
    if ours is not None:
        refuse_beside_ours(context, file, KEPT)
        report = _audit_ours(file, ours, approach, workers, simulate, as_json)
    else:
        from planner.task import GraspTask

        height = table_of(table)
        pull = numbers("--gravity", gravity, 3)
        wanted = None if fingers is None else names(fingers)

        def task_with(spec: str) -> Callable[[Hand], GraspTask]:
            item = object_of(spec, mass=mass)
            return lambda some: GraspTask.create(
                some,
                item,
                table_height=height,
                gravity=pull,
                mu=mu,
                fingers=wanted,
                grip_force=grip_force,
            )

        opened = reading.open(file)
        report = _audit_theirs(
            opened,
            task_with,
            opened.hand(hand),
            object,
            bar=not as_json,
            fingers_told=wanted is not None,
            approach=approach,
            execute=_executed(simulate),
            workers=workers,
        )
    if output is not None:
        report.write(output)
    if as_json:
        print_json(report.to_dict())
    else:
        _show(report, output)
    if not report.complete:
        say(err, "interrupted; what was judged is kept")
        raise typer.Exit(EXIT_INTERRUPTED)
    if not report.ok:
        raise typer.Exit(EXIT_NO)


def _executed(simulate: bool) -> Any:
    """What executes a grasp; None if nothing does."""
    if not simulate:
        return None
    from sim.protocols.dexgraspbench import hold_given_grasp

    return hold_given_grasp


def _audit_ours(
    file: Path, kind: str, approach: bool, workers: int, simulate: bool, quiet: bool
) -> AuditReport:
    """The verdict on plans or a batch of ours, each grasp with the fingers of its task."""
    from planner.audit import audit_grasps, given_of_batch, given_of_plans
    from planner.batch import GraspSet
    from planner.files import read_plan

    if kind == "batch":
        sets = list(given_of_batch(GraspSet(file), file))
    else:
        files = listed_plans([file])
        called = None if kind == "plan" else [one.stem for one in files]
        sets = list(given_of_plans([read_plan(one) for one in files], file, called))
    reports = []
    total = sum(len(given) for _, given in sets)
    with ProgressBar(err, quiet=quiet) as bar:
        for task, given in sets:
            reports.append(
                audit_grasps(
                    task,
                    given,
                    fingers_told=True,
                    approach=approach,
                    execute=_executed(simulate),
                    workers=workers if kind == "batch" else 1,
                    progress=lambda _: bar.show("judging", bar.done + 1, total),
                )
            )
            if not reports[-1].complete:
                break
    return _joined(reports, total)


def _audit_theirs(
    file: GraspFile,
    task_with: Callable[[str], Callable[[Hand], GraspTask]],
    hand: Hand,
    object: str | None,
    *,
    bar: bool,
    fingers_told: bool,
    **options: Any,
) -> AuditReport:
    """The verdict on a file of another tool, object by object."""
    from dataclasses import replace

    from planner.audit import audit_grasps, right_task

    objects = file.objects(file.grasps(hand), object)
    sets = [
        right_task(replace(file, object=name), task_with(spec), hand, fingers_told=fingers_told)
        for name, spec in objects.items()
    ]
    total = sum(len(given) for _, given in sets)
    reports = []
    with ProgressBar(err, quiet=not bar) as shown:
        for task, given in sets:
            reports.append(
                audit_grasps(
                    task,
                    given,
                    fingers_told=fingers_told,
                    progress=lambda _: shown.show("judging", shown.done + 1, total),
                    **options,
                )
            )
            if not reports[-1].complete:
                break
    return _joined(reports, total)


def _joined(reports: Sequence[AuditReport], total: int) -> AuditReport:
    """Reports as one, rows numbered through."""
    from dataclasses import replace

    from planner.audit import joined_reports

    joined = joined_reports(reports)
    rows = tuple(replace(row, index=i) for i, row in enumerate(joined.rows))
    return replace(joined, rows=rows, total=total)


def _show(report: AuditReport, output: Path | None) -> None:
    """Tables for people."""
    wide = Console(width=max(out.width, TABLE_WIDTH))
    wide.print(_stage_table(report))
    faults = [row for row in report.rows if not row.passed]
    for row in faults[:SHOWN]:
        text = row.reason or row.stages[row.first_fault].reason
        say(out, escape(f"{row.name}: {text}"))
    if len(faults) > SHOWN:
        more = f"; all are in {output}" if output is not None else "; --out FILE.csv keeps all"
        say(out, escape(f"... and {len(faults) - SHOWN} more{more}"))
    half, most = report.tolerance_mm(0.5), report.tolerance_mm(0.9)
    if half is not None and most is not None and report.stages["gap"]["failed"]:
        text = f"half of the grasps would touch at a tolerance of {half:.2g} mm, 90 % at {most:.2g}"
        say(out, f"{text} mm; 0.5 mm is asked for")
    for sentence in report.assumed:
        say(out, escape(f"taken for granted: {sentence}"))
    say(out, escape(f"{report.source}: {report.summary}"))


def _stage_table(report: AuditReport) -> Table:
    """How many grasps pass each stage."""
    from planner.audit import STAGES
    from sim.tables import percent, table_of

    table = table_of(
        f"{report.hand} grasps {report.object}",
        ["stage", "asks whether"],
        ["pass", "fail", "not judged", "share of all"],
    )
    for stage in STAGES:
        if stage.name in report.stages:
            counts = report.stages[stage.name]
            table.add_row(
                stage.name,
                stage.asks,
                *(str(counts[n]) for n in ("passed", "failed", "not_judged")),
                percent(counts["passed"], len(report)),
            )
    table.add_section()
    failed = len(report) - report.passed
    table.add_row(
        "all", "", str(report.passed), str(failed), "", percent(report.passed, len(report))
    )
    return table
