"""Commands that plan a grasp: ``run``, ``plan``."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, cast

import typer

from sim.cli.common import check_folder, exit_for, make_folder, out, print_json, tell, told_command
from sim.cli.execution import TrialOptions, truth_of
from sim.cli.options import (
    SEARCH,
    ArrowsOption,
    HandArgument,
    JsonOption,
    PictureOption,
    SeenArgument,
    command,
    flag,
    option,
)
from sim.cli.search import BestOptions, numbered, plans_table
from sim.cli.tasks import is_cloud, object_of

LONGEST_NAME = 60
"""Characters of an object in a folder's name."""


def _folder_name(item: Any) -> str:
    """An object in the name of a folder: with its sizes, where it is told by sizes."""
    spec: str = item.shape.spec
    return item.name if "/" in spec or len(spec) > LONGEST_NAME else spec.replace(":", "-")


@command
def run(
    context: typer.Context,
    hand: HandArgument,
    object: SeenArgument,
    out_dir: Annotated[
        Path | None, option("Folder for plan, report, its page and picture.", None, None, "--out")
    ] = None,
    handover_to: Annotated[
        str | None,
        option("Then hand it over: a hand's name, or that of a pair's other hand.", "HAND", None),
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
    from planner.files import plain_name, read_json, write_plan
    from sim.report_file import write_report

    if out_dir is not None:
        make_folder(out_dir)
    cloud = is_cloud(object)
    truth = truth_of(object, needed=False) if cloud else None
    execute = trial.trial(truth, handover=handover_to is not None)
    trial.check_policy(hand, lambda: object_of(object, **request.told_of_object()), None)
    request, write = trial.reckoned(request), cast(Any, write_plan)
    if handover_to is None:
        found: Any = request.of_cloud(hand, object) if cloud else request.plan(hand, object)
        plan: Any = found.plan if cloud else found
    else:
        from planner.files import write_handover

        found, write = request.handover(hand, object, handover_to), write_handover
        plan = found
    hand_name, item = plan.task.hand.name, _folder_name(plan.task.object)
    folder = out_dir or Path("runs") / f"{plain_name(hand_name)}-{plain_name(item)}-{request.seed}"
    make_folder(folder)
    for old in ("report.json", "report.html", "held.png", "held-end.png"):  # of an earlier plan
        (folder / old).unlink(missing_ok=True)
    write(plan, folder / "plan.json")
    if not as_json and trial.verbose:
        tell(str(plan))
    report = replace(execute(found, folder / "held.png"), command=told_command(context))
    if cloud and report.plan is not plan:  # another of its plans
        write(report.plan, folder / "plan.json")
    write_report(report.to_dict(), folder / "report.json")
    report.save_html(folder / "report.html")
    if as_json:
        print_json(
            {"plan": read_json(folder / "plan.json", "plan file"), "report": report.to_dict()}
        )
    else:
        trial.show(report)
        picture = "held.png" if report.picture else f"no picture: {report.picture_reason}"
        page = folder / "report.html"
        tell(f"open in a browser: {page} (beside plan.json, report.json; {picture})")
    exit_for(report)


@command
def plan(
    hand: HandArgument,
    object: SeenArgument,
    output: Annotated[
        Path,
        option("The plan file; of several, NAME-1.json and so on.", None, None, "--out", "-o"),
    ] = Path("plan.json"),
    picture: PictureOption = None,
    arrows: ArrowsOption = False,
    n: Annotated[int, option("Grasps.", "N", SEARCH, "-n", "--number", min=1)] = 1,
    diverse: Annotated[
        bool, flag("--diverse", "Of more that are found, the N that differ most.", SEARCH)
    ] = False,
    *,
    request: BestOptions,
    as_json: JsonOption = False,
) -> None:
    """Plan a grasp, or several, and write it to a file."""
    from planner.files import plan_to_dict, write_plan

    check_folder(output, picture)
    many = n > 1 or diverse
    if many:
        found = request.several(hand, object, n, diverse=diverse)
    else:
        found = [request.plan(hand, object)]
    files = numbered(output, len(found)) if many else [output]
    for plan, file in zip(found, files, strict=True):
        write_plan(plan, file)
    drawn = ""
    if picture is not None:
        from sim.manipulation.drawing import draw_grasp

        drawings = numbered(picture, len(found)) if many else [picture]
        for plan, drawing in zip(found, drawings, strict=True):
            drawn = draw_grasp(plan, drawing, arrows=arrows)
    if as_json:
        data = [plan_to_dict(plan) for plan in found]
        print_json({"plans": data} if many else data[0])
    elif many:
        out.print(plans_table(found, files))
    else:
        tell(str(found[0]), f"written to {output}", *filter(None, [drawn]))
