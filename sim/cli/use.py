"""``opposable use``: plan the grasp of a tool for its use, use it in MuJoCo, judge."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.markup import escape

from planner.tolerances import DEFAULT_MU
from sim.cli.common import (
    check_films,
    err,
    exit_for,
    heeding_ctrl_c,
    make_folder,
    out,
    print_json,
    tell,
    told_command,
)
from sim.cli.execution import error_model_of, physics_of
from sim.cli.options import (
    GRIP,
    TRIAL,
    ErrorModelOption,
    ErrorSeedOption,
    HandArgument,
    JsonOption,
    MuOption,
    PhysicsOption,
    SeedOption,
    SimMuOption,
    VerboseOption,
    VideoOption,
    ViewOption,
    argument,
    command,
    option,
)

if TYPE_CHECKING:
    from planner.motion.plan import ManipulationPlan
    from planner.plan import GraspPlan
    from planner.search.grasp import Attempt
    from planner.tools import Tool

ToolArgument = Annotated[str, argument("screwdriver, key, lid, hammer, or NAME.toml.", "TOOL")]


@dataclass(frozen=True, kw_only=True)
class UseOptions:
    """What ``use`` is asked for beside hand and tool."""

    by: Annotated[str, option("wrist; or fingers: the palm stands still.", "HOW", GRIP)] = "wrist"
    seed: SeedOption = 0
    scale: Annotated[float, option("How many times larger the tool is.", "K", GRIP)] = 1.0
    margin: Annotated[
        float | None, option("Margin of each needed wrench; 2.", "K", GRIP, min=1.0)
    ] = None
    mu: MuOption = DEFAULT_MU
    resist: Annotated[float, option("Factor on the fixture's friction.", "K", TRIAL, min=0.0)] = 1.0
    sim_mu: SimMuOption = None
    physics: PhysicsOption = "ours"
    error_model: ErrorModelOption = "ideal"
    error_seed: ErrorSeedOption = None
    view: ViewOption = False
    video: VideoOption = None
    verbose: VerboseOption = False

    def plan(self, hand: str, tool: Tool) -> GraspPlan | ManipulationPlan:
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
    out_dir: Annotated[
        Path | None, option("Folder for plan, report, its page and picture.", None, None, "--out")
    ] = None,
    *,
    request: UseOptions,
    as_json: JsonOption = False,
) -> None:
    """Plan the grasp of a tool, use it, judge; writes plan and report.

    Files: plan.json, report.json, used.png, and report.html, to open in any browser: the motion,
    the forces, and what the tool did over time.
    """
    from rich.progress import Progress

    from planner.files import plain_name, read_json, write_manipulation, write_plan
    from planner.plan import GraspPlan
    from planner.tools import load_tool
    from sim.report_file import write_report
    from sim.tools import FingersTrial, UseTrial

    loaded = load_tool(tool, scale=request.scale)
    parts: dict[str, Any] = {
        "physics": physics_of(request.physics, request.sim_mu),
        "error_model": error_model_of(request.error_model, request.error_seed),
    }
    check_films(request.video)
    if out_dir is not None:
        make_folder(out_dir)
    plan = request.plan(hand, loaded)
    name = f"{plain_name(plan.task.hand.name)}-{plain_name(loaded.name)}-{request.seed}"
    folder = out_dir or Path("runs") / name
    make_folder(folder)
    for old in ("report.json", "report.html", "used.png", "used-end.png"):  # of an earlier plan
        (folder / old).unlink(missing_ok=True)
    trial: UseTrial
    if isinstance(plan, GraspPlan):
        write_plan(plan, folder / "plan.json")
        trial = UseTrial(plan, loaded, friction=request.resist, **parts)
    else:
        write_manipulation(plan, folder / "plan.json")
        trial = FingersTrial(plan, loaded, friction=request.resist, **parts)
    if request.verbose and not as_json:
        tell(str(plan))
    with Progress(console=err, transient=True, disable=not err.is_terminal) as progress:
        bar = progress.add_task("using", total=1.0)
        report = trial.run(
            progress=lambda share: progress.update(bar, completed=share),
            view=request.view,
            picture=folder / "used.png",
            video=request.video,
        )
    report = replace(report, command=told_command(context))
    write_report(report.to_dict(), folder / "report.json")
    report.save_html(folder / "report.html")
    if as_json:
        print_json(
            {"plan": read_json(folder / "plan.json", "plan file"), "report": report.to_dict()}
        )
    else:
        out.print(report)
        if request.verbose:
            for line in report.details():
                out.print(line)
        picture = "used.png" if report.picture else f"no picture: {report.picture_reason}"
        page = folder / "report.html"
        tell(f"open in a browser: {page} (beside plan.json, report.json; {picture})")
    exit_for(report)
