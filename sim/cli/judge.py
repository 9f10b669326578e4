"""``opposable refine --judge-only``: the verdict on grasps that somebody else made."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from sim.cli.common import (
    EXIT_INTERRUPTED,
    EXIT_NO,
    check_folder,
    err,
    keep_inputs,
    print_json,
    say,
    show_wide,
    tell,
)
from sim.cli.reading import ReadingOptions, listed_plans
from sim.cli.tasks import TaskOptions
from sim.runner import ProgressBar

if TYPE_CHECKING:
    from rich.table import Table

    from planner.exchange.audit.report import AuditReport
    from planner.exchange.formats import ImportedGrasps
    from planner.task import GraspTask

    Sets = Sequence[tuple[GraspTask, ImportedGrasps]]

SHOWN = 10
"""Grasps that do not pass and are listed with their reasons."""


def check_rows(output: Path | None, file: Path) -> None:
    """Refuse a file of rows that cannot be written.

    Raises:
        PlannerError: Its folder, its form, or that it is the input.
    """
    from planner.exchange.audit.report import check_form

    check_folder(output)
    keep_inputs(output, file)
    if output is not None:
        check_form(output)


def sets_of_ours(file: Path, kind: str) -> Sets:
    """Tasks with their grasps of plans or of a batch of ours.

    Raises:
        PlannerError: A file that cannot be read.
    """
    from planner.batch import GraspSet
    from planner.exchange.audit.grasp_file import batch_as_imported, plans_as_imported
    from planner.files import read_plan

    if kind == "batch":
        return list(batch_as_imported(GraspSet(file), file))
    files = listed_plans([file])
    called = None if kind == "plan" else [one.stem for one in files]
    return list(plans_as_imported([read_plan(one) for one in files], file, called))


def sets_of_theirs(
    file: Path, hand: str | None, object: str | None, reading: ReadingOptions, request: TaskOptions
) -> Sets:
    """Tasks with their grasps of a file of another tool, object by object.

    Raises:
        PlannerError: See ``ReadingOptions.open``.
    """
    from planner.exchange.audit.grasp_file import right_task

    opened = reading.open(file)
    loaded = opened.hand(hand)
    return [
        right_task(
            replace(opened, object=name),
            partial(request.task, object=spec),
            loaded,
            fixed_fingers=request.fingers is not None,
        )
        for name, spec in opened.objects(opened.grasps(loaded), object).items()
    ]


def judge(
    sets: Sets,
    *,
    fixed_fingers: bool,
    approach: bool,
    simulate: bool,
    workers: int,
    output: Path | None,
    as_json: bool,
) -> None:
    """Judge grasps, write their rows, and show what became of them.

    Args:
        sets: Tasks with their grasps.
        fixed_fingers: Whether the tasks say which fingers take part.
        approach: Whether a straight way in is asked for, too.
        simulate: Whether every grasp is executed, too.
        workers: Processes; -1 for one per core.
        output: File of the rows.
        as_json: Whether JSON is printed.

    Raises:
        Exit: Not all pass, or it was interrupted.
    """
    from planner.exchange.audit.report import joined_reports
    from planner.exchange.audit.run import audit_grasps

    execute: Callable[..., Any] | None = None
    if simulate:
        from sim.protocols.dexgraspbench import hold_imported_grasp

        execute = hold_imported_grasp
    reports: list[AuditReport] = []
    total = sum(len(given) for _, given in sets)
    with ProgressBar(err, quiet=as_json) as bar:
        for task, given in sets:
            reports.append(
                audit_grasps(
                    task,
                    given,
                    fixed_fingers=fixed_fingers,
                    approach=approach,
                    execute=execute,
                    workers=workers,
                    progress=lambda _: bar.show("judging", bar.done + 1, total),
                )
            )
            if not reports[-1].complete:
                break
    joined = joined_reports(reports)
    rows = tuple(replace(row, index=i) for i, row in enumerate(joined.rows))
    report = replace(joined, rows=rows, total=total)
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


def _show(report: AuditReport, output: Path | None) -> None:
    """Tables for people."""
    show_wide(_stage_table(report))
    faults = [row for row in report.rows if not row.passed]
    for row in faults[:SHOWN]:
        text = row.reason or row.stages[row.first_fault].reason
        tell(f"{row.name}: {text}")
    if len(faults) > SHOWN:
        more = f"; all are in {output}" if output is not None else "; --out FILE.csv keeps all"
        tell(f"... and {len(faults) - SHOWN} more{more}")
    half, most = report.tolerance_mm(0.5), report.tolerance_mm(0.9)
    if half is not None and most is not None and report.stages["gap"]["failed"]:
        text = f"half of the grasps would touch at a tolerance of {half:.2g} mm, 90 % at {most:.2g}"
        tell(f"{text} mm; 0.5 mm is asked for")
    for sentence in report.assumed:
        tell(f"taken for granted: {sentence}")
    tell(f"{report.source}: {report.summary}")


def _stage_table(report: AuditReport) -> Table:
    """How many grasps pass each stage."""
    from planner.exchange.audit.report import STAGES
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
