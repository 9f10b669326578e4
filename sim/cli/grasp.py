"""Commands that plan and execute: ``run``, ``plan``, ``simulate``."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.markup import escape

from sim.cli.common import (
    SEARCH_PANEL,
    ArrowsOption,
    HandArgument,
    JsonOption,
    ObjectArgument,
    PictureOption,
    PlanArgument,
    check_folder,
    check_policy,
    errors_for_people,
    exit_for,
    keep_inputs,
    make_folder,
    out,
    print_json,
    reckoning_with,
    say,
    told_command,
)
from sim.cli.options import BestOptions, TrialOptions, with_options
from sim.cli.reading import one_plan
from sim.cli.several import numbered, plans_table

LONGEST_NAME = 60
"""Characters of an object in a folder's name."""


def _folder_name(item: Any) -> str:
    """An object in the name of a folder: with its sizes, where it is told by sizes."""
    spec: str = item.shape.spec
    return item.name if "/" in spec or len(spec) > LONGEST_NAME else spec.replace(":", "-")


@errors_for_people()
@with_options
def run(
    context: typer.Context,
    hand: HandArgument,
    object: ObjectArgument,
    out_dir: Annotated[
        Path | None, typer.Option("--out", help="Folder for plan, report, its page and picture.")
    ] = None,
    *,
    request: BestOptions,
    trial: TrialOptions,
    as_json: JsonOption = False,
) -> None:
    """Plan a grasp, execute it, judge it; writes plan and report.

    Files: plan.json, report.json, held.png, and report.html, to open in any browser: the motion,
    the forces over time, the numbers.
    """
    from planner.files import plain_name, plan_to_dict, write_plan
    from planner.objects import parse_object
    from sim.report_file import write_report

    if out_dir is not None:
        make_folder(out_dir)
    execute = trial.trial()
    check_policy(trial, hand, lambda: parse_object(object), None)
    plan = reckoning_with(request, trial.reality).plan(hand, object)
    hand_name, item = plan.task.hand.name, _folder_name(plan.task.object)
    folder = out_dir or Path("runs") / f"{plain_name(hand_name)}-{plain_name(item)}-{request.seed}"
    make_folder(folder)
    for old in ("report.json", "report.html", "held.png", "held-end.png"):  # of an earlier plan
        (folder / old).unlink(missing_ok=True)
    write_plan(plan, folder / "plan.json")
    if not as_json and trial.verbose:
        say(out, escape(str(plan)))
    report = replace(execute(plan, folder / "held.png"), command=told_command(context))
    write_report(report.to_dict(), folder / "report.json")
    report.save_html(folder / "report.html")
    if as_json:
        print_json({"plan": plan_to_dict(plan), "report": report.to_dict()})
    else:
        trial.show(report)
        picture = "held.png" if report.picture else f"no picture: {report.picture_reason}"
        page = folder / "report.html"
        say(out, escape(f"open in a browser: {page} (beside plan.json, report.json; {picture})"))
    exit_for(report)


@errors_for_people()
@with_options
def plan(
    hand: HandArgument,
    object: ObjectArgument,
    output: Annotated[
        Path, typer.Option("--out", "-o", help="The plan file; of several, NAME-1.json and so on.")
    ] = Path("plan.json"),
    picture: PictureOption = None,
    arrows: ArrowsOption = False,
    n: Annotated[
        int,
        typer.Option(
            "-n", "--number", min=1, help="Grasps.", metavar="N", rich_help_panel=SEARCH_PANEL
        ),
    ] = 1,
    diverse: Annotated[
        bool,
        typer.Option(
            "--diverse",
            help="Of more that are found, the N that differ most.",
            metavar="",
            rich_help_panel=SEARCH_PANEL,
        ),
    ] = False,
    *,
    request: BestOptions,
    as_json: JsonOption = False,
) -> None:
    """Plan a grasp, or several, and write it to a file."""
    from planner.files import plan_to_dict, write_plan
    from sim.manipulation.drawing import draw_grasp

    check_folder(output)
    check_folder(picture)
    if n > 1 or diverse:
        found_several = request.several(hand, object, n, diverse=diverse)
        files = numbered(output, len(found_several))
        for plan, file in zip(found_several, files, strict=True):
            write_plan(plan, file)
        if picture is not None:
            drawings = numbered(picture, len(found_several))
            for plan, drawing in zip(found_several, drawings, strict=True):
                draw_grasp(plan, drawing, arrows=arrows)
        if as_json:
            print_json({"plans": [plan_to_dict(plan) for plan in found_several]})
        else:
            out.print(plans_table(found_several, files))
        return
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
    context: typer.Context,
    plan_file: PlanArgument,
    report_file: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            help="Report (JSON), its page (HTML) beside it; .html: the page only.",
            metavar="FILE",
        ),
    ] = None,
    picture: PictureOption = None,
    *,
    trial: TrialOptions,
    as_json: JsonOption = False,
) -> None:
    """Execute a plan file in MuJoCo and judge whether it holds."""
    from sim.report_file import PAGE_SUFFIXES, write_report

    check_folder(report_file)
    check_folder(picture)
    keep_inputs(report_file, plan_file)
    plan = one_plan(plan_file)
    check_policy(trial, plan.task.hand, lambda: plan.task.object, None)
    report = replace(trial.trial()(plan, picture), command=told_command(context))
    page = None if report_file is None else report_file.with_suffix(".html")
    if report_file is not None and report_file.suffix.lower() in PAGE_SUFFIXES:
        page = report_file
    elif report_file is not None:
        write_report(report.to_dict(), report_file)
    if page is not None:
        report.save_html(page)
    if as_json:
        print_json(report.to_dict())
    else:
        trial.show(report, picture=picture is not None)
        if page is not None:
            say(out, escape(f"open in a browser: {page}"))
    exit_for(report)
