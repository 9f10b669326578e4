"""Commands that plan a grasp: ``run``, ``plan``, and ``use`` for that of a tool."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer
from rich.markup import escape

from planner.tolerances import DEFAULT_MU
from sim.cli.common import (
    check_films,
    check_folder,
    err,
    exit_for,
    heeding_ctrl_c,
    make_folder,
    out,
    print_json,
    tell,
    told_command,
    warn_of_friction,
)
from sim.cli.execution import (
    TrialOptions,
    error_model_of,
    physics_of,
    print_report,
    share_bar,
    tell_truth,
    trial_of,
)
from sim.cli.options import (
    GRIP,
    SEARCH,
    TRIAL,
    ArrowsOption,
    ErrorModelOption,
    ErrorSeedOption,
    HandArgument,
    JsonOption,
    MuOption,
    PhysicsOption,
    PictureOption,
    SeedOption,
    SeenArgument,
    SimMuOption,
    VerboseOption,
    VideoOption,
    ViewOption,
    argument,
    command,
    flag,
    option,
)
from sim.cli.search import BestOptions, numbered, plans_table
from sim.cli.tasks import is_cloud, object_of

if TYPE_CHECKING:
    from planner.motion.plan import ManipulationPlan
    from planner.plan import GraspPlan
    from planner.search.grasp import Attempt
    from planner.tools import Tool

LONGEST_NAME = 60
"""Characters of an object in a folder's name."""


def _folder_name(item: Any) -> str:
    """An object in the name of a folder: with its sizes, where it is told by sizes."""
    spec: str = item.shape.spec
    return item.name if "/" in spec or len(spec) > LONGEST_NAME else spec.replace(":", "-")


FolderOption = Annotated[
    Path | None, option("Folder for plan, report, its page and picture.", None, None, "--out")
]


def _begun(out_dir: Path | None, hand: str, item: str, seed: int, picture: str) -> Path:
    """The folder of a run, without report and pictures of an earlier plan."""
    from planner.files import plain_name

    folder = out_dir or Path("runs") / f"{plain_name(hand)}-{plain_name(item)}-{seed}"
    make_folder(folder)
    for old in ("report.json", "report.html", f"{picture}.png", f"{picture}-end.png"):
        (folder / old).unlink(missing_ok=True)
    return folder


def _end(
    report: Any, folder: Path, picture: str, show: Callable[[Any], None], as_json: bool
) -> None:
    """Write the report of a run and its page, show them, and end by what came out."""
    from planner.files import read_json
    from sim.report_file import write_report

    write_report(report.to_dict(), folder / "report.json")
    report.save_html(folder / "report.html")
    if as_json:
        plan = read_json(folder / "plan.json", "plan file")
        print_json({"plan": plan, "report": report.to_dict()})
    else:
        show(report)
        drawn = f"{picture}.png" if report.picture else f"no picture: {report.picture_reason}"
        page = folder / "report.html"
        tell(f"open in a browser: {page} (beside plan.json, report.json; {drawn})")
    exit_for(report)


@command
def run(
    context: typer.Context,
    hand: HandArgument,
    object: SeenArgument,
    out_dir: FolderOption = None,
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
    from planner.files import write_plan

    if out_dir is not None:
        make_folder(out_dir)
    cloud, truth = is_cloud(object), None
    if cloud:
        from sim.scan import scanned_truth  # here: for clouds alone

        truth = scanned_truth(object)
    execute = trial.trial(truth, movement=handover_to is not None)
    trial.check_policy(hand, lambda: object_of(object, **request.told_of_object()), None)
    request, write = trial.reckoned(request), cast(Any, write_plan)
    if handover_to is None:
        found: Any = request.of_cloud(hand, object) if cloud else request.plan(hand, object)
        plan: Any = found.plan if cloud else found
    else:
        from planner.files import write_movement

        found, write = request.handover(hand, object, handover_to), write_movement
        plan = found
    item = _folder_name(plan.task.object)
    if cloud:
        tell_truth(object, truth)
        item = Path(object).stem
    folder = _begun(out_dir, plan.task.hand.name, item, request.seed, "held")
    write(plan, folder / "plan.json")
    if not as_json and trial.verbose:
        tell(str(plan))
    report = replace(execute(found, folder / "held.png"), command=told_command(context))
    if cloud and report.plan is not plan:  # another of its plans
        write(report.plan, folder / "plan.json")
    _end(report, folder, "held", trial.show, as_json)


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


ToolArgument = Annotated[str, argument("screwdriver, spray_bottle, ..., or NAME.toml.", "TOOL")]


@dataclass(frozen=True, kw_only=True)
class UseOptions:
    """What ``use`` is asked for beside hand and tool."""

    by: Annotated[str, option("wrist or fingers.", "HOW", GRIP)] = "wrist"
    seed: SeedOption = 0
    scale: Annotated[float, option("Factor on its size.", "K", GRIP)] = 1.0
    margin: Annotated[
        float | None, option("Margin of each needed wrench; 2.", "K", GRIP, min=1.0)
    ] = None
    mu: MuOption = DEFAULT_MU
    resist: Annotated[float, option("Fixture friction, factor.", "K", TRIAL, min=0.0)] = 1.0
    sim_mu: SimMuOption = None
    physics: PhysicsOption = "ours"
    error_model: ErrorModelOption = "ideal"
    error_seed: ErrorSeedOption = None
    view: ViewOption = False
    video: VideoOption = None
    verbose: VerboseOption = False

    def plan(self, hand: str, tool: Tool) -> ManipulationPlan:
        """Plan with a spinner that counts attempts, on stderr."""
        from sim.tools import plan_fingers, plan_tool
        from sim.tools.fingers import checked_by

        margin: dict[str, Any] = {} if self.margin is None else {"needed_margin": self.margin}
        margin["mu"] = self.mu
        if checked_by(self.by) == "fingers":
            with err.status(f"planning: {hand} turns {tool.name} by strokes and regrasps"):
                return plan_fingers(hand, tool, seed=self.seed, **margin)
        with heeding_ctrl_c() as check, err.status(f"planning: {hand}, {tool.name}") as status:

            def show(attempt: Attempt[GraspPlan]) -> bool:
                outcome = escape(str(attempt.failure or "found")[:70])
                status.update(f"planning: attempt {attempt.index + 1}: {outcome}")
                check()
                return False

            return plan_tool(
                hand,
                tool,
                seed=self.seed,
                progress=show,
                **margin,
            )


@command
def use(
    context: typer.Context,
    hand: HandArgument,
    tool: ToolArgument,
    out_dir: FolderOption = None,
    *,
    request: UseOptions,
    as_json: JsonOption = False,
) -> None:
    """Plan the grasp of a tool, use it, judge; writes plan and report.

    Files: plan.json, report.json, used.png, and report.html, to open in any browser: the motion,
    the forces, and what the tool did over time.
    """
    from planner.arrays import checked_number
    from planner.errors import TaskError
    from planner.files import write_movement
    from planner.tools import load_tool
    from sim.tools.trial import MOST_RESIST

    checked_number("--resist", request.resist, least=0.0, most=MOST_RESIST, error=TaskError)
    loaded = load_tool(tool, scale=request.scale)
    parts: dict[str, Any] = {
        "physics": physics_of(request.physics, request.sim_mu),
        "error_model": error_model_of(request.error_model, request.error_seed),
    }
    check_films(request.video)
    warn_of_friction(request.mu, parts["physics"].mu)
    if out_dir is not None:
        make_folder(out_dir)
    plan = request.plan(hand, loaded)
    folder = _begun(out_dir, plan.task.hand.name, loaded.name, request.seed, "used")
    write_movement(plan, folder / "plan.json")
    trial = trial_of(plan)(plan, friction=request.resist, **parts)
    if request.verbose and not as_json:
        tell(str(plan))
    with share_bar("using") as progress:
        report = trial.run(
            progress=progress,
            view=request.view,
            picture=folder / "used.png",
            video=request.video,
        )
    report = replace(report, command=told_command(context))
    _end(report, folder, "used", lambda made: print_report(made, request.verbose), as_json)
