"""Commands that plan and execute: ``run``, ``plan``, ``simulate``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
from rich.markup import escape

from sim.cli.common import (
    ArrowsOption,
    HandArgument,
    JsonOption,
    ObjectArgument,
    PictureOption,
    PlanArgument,
    check_folder,
    errors_for_people,
    exit_for,
    make_folder,
    out,
    print_json,
    say,
)
from sim.cli.options import PlanOptions, TrialOptions, with_options

LONGEST_NAME = 60
"""Characters of an object in a folder's name."""


def _folder_name(item: Any) -> str:
    """An object in the name of a folder: with its sizes, where it is told by sizes."""
    spec: str = item.shape.spec
    return item.name if "/" in spec or len(spec) > LONGEST_NAME else spec.replace(":", "-")


@errors_for_people()
@with_options
def run(
    hand: HandArgument,
    object: ObjectArgument,
    out_dir: Annotated[
        Path | None, typer.Option("--out", help="Folder for plan, report and picture.")
    ] = None,
    *,
    request: PlanOptions,
    trial: TrialOptions,
    as_json: JsonOption = False,
) -> None:
    """Plan a grasp, distribute its forces, execute it, judge it; writes plan, report, picture."""
    from planner.files import plain_name, plan_to_dict, write_json, write_plan

    execute = trial.trial()
    if out_dir is not None:
        make_folder(out_dir)
    plan = request.plan(hand, object)
    hand_name, item = plan.task.hand.name, _folder_name(plan.task.object)
    folder = out_dir or Path("runs") / f"{plain_name(hand_name)}-{plain_name(item)}-{request.seed}"
    make_folder(folder)
    for old in ("report.json", "held.png", "held-end.png"):  # of an earlier plan in this folder
        (folder / old).unlink(missing_ok=True)
    write_plan(plan, folder / "plan.json")
    if not as_json:
        say(out, escape(str(plan)))
    report = execute(plan, folder / "held.png")
    write_json(report.to_dict(), folder / "report.json")
    if as_json:
        print_json({"plan": plan_to_dict(plan), "report": report.to_dict()})
    else:
        out.print(report)
        note = "" if report.picture else f" (no picture: {report.picture_reason})"
        say(out, escape(f"written to {folder}: plan.json, report.json{note}"))
        if report.drawn:
            say(out, escape(report.drawn))
    exit_for(report)


@errors_for_people()
@with_options
def plan(
    hand: HandArgument,
    object: ObjectArgument,
    output: Annotated[Path, typer.Option("--out", "-o", help="The plan file.")] = Path("plan.json"),
    picture: PictureOption = None,
    arrows: ArrowsOption = False,
    *,
    request: PlanOptions,
    as_json: JsonOption = False,
) -> None:
    """Plan a grasp and write it to a file."""
    from planner.files import plan_to_dict, write_plan
    from sim.manipulation.drawing import draw_grasp

    check_folder(output)
    check_folder(picture)
    found = request.plan(hand, object)
    write_plan(found, output)
    drawn = "" if picture is None else draw_grasp(found, picture, arrows=arrows)
    if as_json:
        print_json(plan_to_dict(found))
    else:
        say(out, escape(str(found)))
        say(out, escape(f"written to {output}"))
        if drawn:
            say(out, escape(drawn))


@errors_for_people()
@with_options
def simulate(
    plan_file: PlanArgument,
    report_file: Annotated[
        Path | None, typer.Option("--out", "-o", help="Write the trial report here.")
    ] = None,
    picture: PictureOption = None,
    *,
    trial: TrialOptions,
    as_json: JsonOption = False,
) -> None:
    """Execute a plan file in MuJoCo: approach, close, squeeze, lift, hold; and judge it."""
    from planner.files import read_plan, write_json

    check_folder(report_file)
    check_folder(picture)
    report = trial.trial()(read_plan(plan_file), picture)
    if report_file is not None:
        write_json(report.to_dict(), report_file)
    if as_json:
        print_json(report.to_dict())
    else:
        out.print(report)
        if report.drawn:
            say(out, escape(report.drawn))
    exit_for(report)


def register(app: typer.Typer) -> None:
    """Add the commands."""
    for command in (run, plan, simulate):
        app.command()(command)
