"""The command ``test``: plans executed in MuJoCo, held as they are or under a protocol."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.markup import escape

from sim.cli.common import (
    EXIT_INTERRUPTED,
    EXIT_NO,
    check_folder,
    err,
    exit_for,
    heeding_ctrl_c,
    keep_inputs,
    make_folder,
    out,
    print_json,
    refuse_given,
    say,
    show_wide,
    tell,
    told_command,
)
from sim.cli.execution import TrialOptions, physics_of, truth_of
from sim.cli.options import (
    TRIAL,
    JsonOption,
    PictureOption,
    SeedOption,
    WorkersOption,
    command,
    option,
)
from sim.cli.reading import listed_plans, one_plan, plan_to_test

if TYPE_CHECKING:
    from planner.plan import GraspPlan
    from sim.protocols import ProtocolReport

HOLD, CREEP = "hold", "creep"
"""The protocols of one plan: whether it holds, and how fast what it holds creeps."""

PAGES = ("none", "failures", "all")
"""Of which trials pages are written."""

OF_PROTOCOLS = "Protocols"
"""Group of options in the help."""

OF_HOLD = {"picture", "truth", "view", "arrows", "verbose"}
OF_CREEP = {"budget"}
OF_TRIALS = {"only", "workers", "pages", "seed"}
OF_EXECUTION = {
    *("sim_mu", "error_model", "error_seed", "estimate", "pads", "controller"),
    *("video", "output"),
}
"""Parameters that mean something for some protocols alone: for ``hold``, for ``creep``, for those
of many trials, and for all but ``creep``."""


@dataclass(frozen=True, kw_only=True)
class TestOptions(TrialOptions):
    """How plans are executed; a protocol of many trials makes many films."""

    __test__ = False  # pytest would collect it

    physics: Annotated[
        str,
        option(
            "ours, mujoco-default (of creep), menagerie, dexgraspbench, or a file.",
            "NAME",
            TRIAL,
            show_default=False,
        ),
    ] = ""
    video: Annotated[
        Path | None, option("Film: run.mp4, .webp, .gif; of many trials mp4, webp or gif.", "FILE")
    ] = None


@dataclass(frozen=True, kw_only=True)
class ProtocolOptions:
    """What the protocols of many trials are asked for."""

    only: Annotated[
        list[str] | None,
        option('Only trials of this name: "force +z".', "NAME", OF_PROTOCOLS),
    ] = None
    pages: Annotated[str, option("Pages: none, failures, all.", "WHICH", OF_PROTOCOLS)] = "none"
    workers: WorkersOption = -1
    seed: SeedOption = 0


@command
def test(
    context: typer.Context,
    plans: Annotated[
        list[Path], typer.Argument(help="Plan files, or folders of them.", metavar="PLAN...")
    ],
    protocol: Annotated[
        str,
        option(
            "hold, creep, dexgraspbench, forces, shake, robust, drake, errors, pushes, or all.",
            "NAME",
        ),
    ] = HOLD,
    output: Annotated[
        Path | None,
        option(
            "Of hold: report (JSON), its page (HTML) beside it; .html: the page only. Else a "
            "folder for reports and trials.csv.",
            "PATH",
            None,
            "--out",
            "-o",
        ),
    ] = None,
    picture: PictureOption = None,
    truth: Annotated[
        Path | None, option("Of hold: on the object of this scan.", "CLOUD", TRIAL)
    ] = None,
    budget: Annotated[
        float, option("Largest creep that is wanted, mm/s.", "V", OF_PROTOCOLS)
    ] = 0.1,
    *,
    asked: ProtocolOptions,
    trial: TestOptions,
    as_json: JsonOption = False,
) -> None:
    r"""Test plans in MuJoCo: held, pushed, shaken, with errors.

    The protocol "hold" executes a plan and judges whether the object is held. "creep" measures how
    fast a held object creeps and tries what would slow it; by default in MuJoCo's own physics.
    "all" leaves out hold, creep, errors (of lab), pushes, drake
    (pip install "opposable\[drake]"), and what a hand cannot take.

    Exit code 0 if every grasp held in every trial without a growing load and bore the first load at
    rest in every direction; of creep if it keeps to the budget.
    """
    idle = OF_CREEP | OF_TRIALS if protocol == HOLD else OF_HOLD | OF_CREEP
    if protocol == CREEP:
        idle = OF_HOLD | OF_TRIALS | OF_EXECUTION
    refuse_given(context, f"--protocol {protocol} takes other options", of=idle)
    if protocol == CREEP:
        _creep(plans, trial.physics or "mujoco-default", budget, as_json)
        return
    trial = replace(trial, physics=trial.physics or "ours")
    if protocol == HOLD:
        _hold(plans, output, picture, truth, trial, told_command(context), as_json)
        return
    folder = output or Path("runs/test")
    _trials(plans, protocol, folder, asked, trial, told_command(context), as_json)


def _hold(
    plans: Sequence[Path],
    output: Path | None,
    picture: Path | None,
    truth: Path | None,
    trial: TrialOptions,
    command: str,
    as_json: bool,
) -> None:
    """Execute each plan as it is; files belong to a single one."""
    from planner.errors import TaskError
    from planner.plan import GraspPlan
    from sim.report_file import PAGE_SUFFIXES, write_report

    check_folder(output, picture)
    files = listed_plans(plans)
    if len(files) > 1 and any((output, picture, trial.video)):
        raise TaskError(
            f"--out, --picture and --video are of one plan, and {len(files)} are given; leave them "
            "out, or give one plan"
        )
    keep_inputs(output, *files)
    there = None if truth is None else truth_of(truth, needed=True)
    loaded = [plan_to_test(file) for file in files]
    for plan in loaded:
        trial.check_policy(plan.task.hand, partial(getattr, plan.task, "object"), None)
    reports = []
    for file, plan in zip(files, loaded, strict=True):
        execute = trial.trial(there, movement=not isinstance(plan, GraspPlan))
        report = replace(execute(plan, picture), command=command)
        reports.append(report)
        page = None if output is None else output.with_suffix(".html")
        if output is not None and output.suffix.lower() in PAGE_SUFFIXES:
            page = output
        elif output is not None:
            write_report(report.to_dict(), output)
        if page is not None:
            report.save_html(page)
        if not as_json:
            if len(files) > 1:
                tell(f"{file}:")
            trial.show(report, picture=picture is not None)
            if page is not None:
                tell(f"open in a browser: {page}")
        if report.reason == "interrupted":
            break
    if as_json:
        data = [report.to_dict() for report in reports]
        print_json(data[0] if len(files) == 1 else {"reports": data})
    for report in reversed(reports):  # an interrupted one is the last
        exit_for(report)


def _creep(plans: Sequence[Path], physics: str, budget: float, as_json: bool) -> None:
    """How fast a held object creeps, and what to do about it.

    Each change is tried and made larger until the creep that is measured keeps to the budget.
    """
    from planner.errors import TaskError
    from sim.protocols.creep import measure_creep, sized_remedies

    files = listed_plans(plans)
    if len(files) > 1:
        raise TaskError(f"--protocol creep takes one plan, and {len(files)} are given; give one")
    plan, computed = one_plan(files[0]), physics_of(physics)
    if not 0 < budget < float("inf"):
        raise TaskError(f"--budget is {budget:g}; give a finite speed > 0 in mm/s")
    with err.status(f"creep: {plan.task.hand.name}, {plan.task.object.name} ..."):
        seen = measure_creep(plan, computed)
        slow = seen.measured <= 1e-3 * budget
        tried = () if slow else sized_remedies(plan, computed, seen, 1e-3 * budget)
    data: dict[str, Any] = {
        "physics": computed.to_dict(),
        "budget_mm_s": budget,
        "within_budget": slow,
        **_speeds(seen),
        "changes": [{"what": t.remedy.what, "enough": t.enough, **_speeds(t.creep)} for t in tried],
    }
    if as_json:
        print_json(data)
    else:
        tell(f"physics: {computed}", f"creep: {_told(data)}; {budget:g} mm/s are wanted")
        for change in data["changes"]:
            enough = "enough" if change["enough"] else "not enough"
            tell(f"  {enough}: {change['what']}: {_told(change)}")
    if not slow:
        raise typer.Exit(EXIT_NO)


def _speeds(seen: Any) -> dict[str, Any]:
    return {
        "creep_mm_s": 1e3 * seen.measured,
        "formula_mm_s": 1e3 * seen.predicted,
        "formula_however_firm_mm_s": 1e3 * seen.least,
        "lost": seen.lost,
    }


def _told(speeds: dict[str, Any]) -> str:
    """Measured and computed speeds in words."""
    formula = f"by the formula at least {speeds['formula_however_firm_mm_s']:.2g} without noslip"
    if speeds["lost"]:
        return f"lost ({speeds['lost']}); {formula}"
    return f"{speeds['creep_mm_s']:.2g} mm/s; {formula}"


def _trials(
    plans: Sequence[Path],
    protocol: str,
    folder: Path,
    asked: ProtocolOptions,
    options: TestOptions,
    command: str,
    as_json: bool,
) -> None:
    """Run protocols of many trials on every plan; reports as they come."""
    from planner.errors import NotFoundError, TaskError
    from planner.files import read_plan, write_json
    from sim.protocols import (
        PROTOCOLS,
        Settings,
        in_all,
        protocol_table,
        run_protocol,
        trials_of,
        unsuitable,
        write_csv,
    )
    from sim.show.painter import why_not
    from sim.show.picture import check_video

    if asked.pages not in PAGES:  # bad input ends here
        raise NotFoundError("choice of pages", asked.pages, PAGES)
    # the protocol draws from the errors of a laboratory where none are named
    parts = options.parts(draws=protocol == "errors")
    film = options.video
    ending = "" if film is None else film.suffix or f".{film}"
    check_video(f"film{ending}" if ending else None)
    every = protocol == "all"
    if not every and protocol not in PROTOCOLS:
        raise NotFoundError("protocol", protocol, (HOLD, CREEP, *PROTOCOLS, "all"))
    trials = trials_of(in_all() if every else [protocol], asked.only or (), Settings(), asked.seed)
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
                if every and (reason := unsuitable(name, plan.task)):
                    skipped.append({"plan": str(path), "protocol": name, "reason": reason})
                    say(err, f"skipped: {escape(f'{path}: {reason}')}")
                    continue
                stem = f"{number:03d}-{path.stem}-{name}"
                report = run_protocol(
                    plan,
                    name,
                    **parts,
                    seed=asked.seed,
                    workers=asked.workers,
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
                if asked.pages != "none":
                    written += _write_pages(report, plan, folder / stem, asked.pages, command)
                if not as_json:
                    show_wide(protocol_table(report))
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
        tell(f"written to {folder}: a report per plan and protocol, trials.csv{films}")
        if asked.pages != "none":
            first = f", the first is {written[0]}" if written else ""
            tell(f"pages to open in a browser: {len(written)}{first}")
    if not all(report.complete for report in reports):
        say(err, "interrupted; what was done is kept")
        raise typer.Exit(EXIT_INTERRUPTED)
    if not all(report.success for report in reports):
        raise typer.Exit(EXIT_NO)


def _write_pages(
    report: ProtocolReport, plan: GraspPlan, stem: Path, pages: str, command: str
) -> list[Path]:
    """Write a page for every trial, or for those that were not held; the files."""
    from planner.files import plain_name
    from planner.pages.page import write_page
    from sim.protocols.page import outcome_page

    written = []
    for outcome in report.outcomes:
        moved = outcome.recording is not None and len(outcome.recording) > 0
        fine = (outcome.held and not outcome.other_grasp) or outcome.grows
        if not moved or (pages == "failures" and fine):
            continue
        path = stem.with_name(f"{stem.name}-{outcome.index:03d}-{plain_name(outcome.name)}.html")
        write_page(outcome_page(report, outcome, plan, command), path)
        written.append(path)
    return written
