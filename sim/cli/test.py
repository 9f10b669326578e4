"""The command ``test``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.markup import escape

from sim.cli.common import (
    EXIT_INTERRUPTED,
    EXIT_NO,
    ControllerOption,
    EstimateOption,
    JsonOption,
    PadsOption,
    PhysicsOption,
    RealityOption,
    RealitySeedOption,
    SeedOption,
    controller_of,
    err,
    errors_for_people,
    estimate_of,
    heeding_ctrl_c,
    make_folder,
    out,
    physics_of,
    print_json,
    reality_of,
    say,
    told_command,
)
from sim.cli.reading import listed_plans

if TYPE_CHECKING:
    from planner.plan import GraspPlan
    from sim.protocols import ProtocolReport

PAGES = ("none", "failures", "all")
"""Of which trials pages are written."""

TABLE_WIDTH = 120
"""Width of the table, characters."""


@errors_for_people()
def test(
    context: typer.Context,
    plans: Annotated[
        list[Path], typer.Argument(help="Plan files, or folders of them.", metavar="PLAN...")
    ],
    protocol: Annotated[
        str,
        typer.Option(
            help="dexgraspbench, forces, shake, robust, drake, reality, pushes, or all.",
            metavar="NAME",
        ),
    ] = "all",
    controller: ControllerOption = "feedforward",
    physics: PhysicsOption = "ours",
    reality: RealityOption = "ideal",
    reality_seed: RealitySeedOption = None,
    estimate: EstimateOption = None,
    pads: PadsOption = None,
    only: Annotated[
        list[str] | None, typer.Option(help='Only trials of this name: "force +z".', metavar="NAME")
    ] = None,
    workers: Annotated[int, typer.Option(help="Processes; -1 for one per core.", metavar="N")] = -1,
    folder: Annotated[
        Path, typer.Option("--out", help="Folder for reports and trials.csv.", metavar="DIR")
    ] = Path("runs/test"),
    pages: Annotated[
        str,
        typer.Option(help="Pages: none, failures, all."),
    ] = "none",
    seed: SeedOption = 0,
    video: Annotated[
        str | None,
        typer.Option(help="Film every trial into --out: mp4, webp or gif."),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    r"""Test plans in MuJoCo by protocols: pushes, shaking, errors.

    Exit code 0 if every grasp held in every trial without a growing load and bore the first load at
    rest in every direction. "all" leaves out reality (of lab), pushes, drake (pip install
    "opposable\[drake]"), and what a hand cannot take.
    """
    from planner.errors import NotFoundError, TaskError
    from planner.files import read_plan, write_json
    from sim.looking.painter import why_not
    from sim.looking.picture import check_video
    from sim.protocols import (
        IN_ALL,
        Settings,
        protocol_table,
        run_protocol,
        trials_of,
        unsuitable,
        write_csv,
    )

    driver = controller_of(controller)  # bad input ends here
    if pages not in PAGES:
        raise NotFoundError("choice of pages", pages, PAGES)
    draws = protocol == "reality"  # from those of a laboratory where none are named
    computed = physics_of(physics)
    errors = reality_of(reality, reality_seed, pads, draws=draws)
    estimator = estimate_of(estimate)
    ending = "" if video is None else f".{video}"
    check_video(f"film{ending}" if ending else None)
    asked = IN_ALL if protocol == "all" else [protocol]
    trials = trials_of(asked, only or (), Settings(), seed)
    loaded = [(path, read_plan(path)) for path in listed_plans(plans)]
    make_folder(folder)
    if ending and (reason := why_not()):
        say(err, escape(f"no films: {reason}"))
        ending = ""
    reports: list[ProtocolReport] = []
    skipped: list[dict[str, str]] = []
    written: list[Path] = []
    with heeding_ctrl_c() as check:
        for number, (path, plan) in enumerate(loaded):
            for name, some in trials.items():
                if protocol == "all" and (reason := unsuitable(name, plan.task)):
                    skipped.append({"plan": str(path), "protocol": name, "reason": reason})
                    say(err, f"skipped: {escape(f'{path}: {reason}')}")
                    continue
                stem = f"{number:03d}-{path.stem}-{name}"
                report = run_protocol(
                    plan,
                    name,
                    controller=driver,
                    physics=computed,
                    reality=errors,
                    estimator=estimator,
                    seed=seed,
                    workers=workers,
                    only=some,
                    name=str(path),
                    file=folder / f"{stem}.jsonl",
                    video=folder / f"{stem}{ending}" if ending else None,
                    console=err,
                    check=check,
                )
                reports.append(report)
                write_json(report.to_dict(), folder / f"{stem}.json")
                write_csv(reports, folder / "trials.csv")
                if pages != "none":
                    command = told_command(context)
                    written += _write_pages(report, plan, folder / stem, pages, command)
                if not as_json:
                    # a narrow terminal breaks its lines
                    Console(width=max(out.width, TABLE_WIDTH)).print(protocol_table(report))
                    out.print(report)
                if not report.complete:
                    break
            if reports and not reports[-1].complete:
                break
    if not reports:
        raise TaskError("nothing was tested: no plan's hand can take a protocol that was asked for")
    if as_json:
        print_json({"reports": [report.summary() for report in reports], "skipped": skipped})
    else:
        films = f", {len(list(folder.glob(f'*{ending}')))} films" if ending else ""
        say(out, escape(f"written to {folder}: a report per plan and protocol, trials.csv{films}"))
        if pages != "none":
            first = f", the first is {written[0]}" if written else ""
            say(out, escape(f"pages to open in a browser: {len(written)}{first}"))
    if not all(report.complete for report in reports):
        say(err, "interrupted; what was done is kept")
        raise typer.Exit(EXIT_INTERRUPTED)
    if not all(report.success for report in reports):
        raise typer.Exit(EXIT_NO)


def _write_pages(
    report: ProtocolReport, plan: GraspPlan, stem: Path, which: str, command: str
) -> list[Path]:
    """Write a page for every trial, or for those that were not held; the files."""
    from planner.files import plain_name
    from planner.pages.page import write_page
    from sim.protocols.page import outcome_page

    written = []
    for outcome in report.outcomes:
        moved = outcome.recording is not None and len(outcome.recording) > 0
        if not moved or (
            which == "failures" and ((outcome.held and not outcome.other_grasp) or outcome.grows)
        ):
            continue
        path = stem.with_name(f"{stem.name}-{outcome.index:03d}-{plain_name(outcome.name)}.html")
        write_page(outcome_page(report, outcome, plan, command), path)
        written.append(path)
    return written
