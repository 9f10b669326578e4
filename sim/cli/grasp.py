"""Commands that plan and execute: ``run``, ``plan``, ``simulate``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
from rich.markup import escape

from sim.cli.common import (
    AttemptsOption,
    AvoidOption,
    ControllerOption,
    CpuOption,
    DensityOption,
    FingersOption,
    HandArgument,
    JsonOption,
    LoadOption,
    MassOption,
    MuOption,
    ObjectArgument,
    ObjectiveOption,
    PhysicsOption,
    PlanArgument,
    PoseOption,
    RepairOption,
    RoundsOption,
    SeedOption,
    SimMuOption,
    TaskWrenchOption,
    TouchOption,
    ViewOption,
    check_folder,
    err,
    errors_for_people,
    exit_for,
    heeding_ctrl_c,
    make_folder,
    options_of,
    out,
    physics_of,
    print_json,
    say,
)
from sim.cli.requests import task_of_options


def _plan(
    hand: str,
    object: str,
    *,
    fingers: str | None,
    seed: int,
    mu: float,
    mass: float | None,
    density: float | None,
    repair: bool,
    resting: int,
    touch: list[str] | None,
    avoid: list[str] | None,
    expect_load: str | None,
    attempts: int,
    max_cpu_s: float | None,
    objective: str,
    task_wrench: list[str] | None,
    rounds: int | None,
) -> Any:
    """Plan with a spinner that counts attempts on stderr."""
    from planner.plan import GraspPlan
    from planner.search import Attempt, plan_grasp

    options = options_of(objective, task_wrench, rounds)
    task = task_of_options(
        hand,
        object,
        fingers=fingers,
        mu=mu,
        mass=mass,
        density=density,
        repair=repair,
        resting=resting,
        touch=touch,
        avoid=avoid,
        expect_load=expect_load,
    )
    title = f"planning: {task.hand.name}, {task.object.name} ..."
    with heeding_ctrl_c() as check, err.status(title) as status:

        def show(attempt: Attempt[GraspPlan]) -> None:
            check()
            outcome = escape(attempt.reason[:70] or "found")
            status.update(f"planning: attempt {attempt.index + 1}: {outcome}")

        return plan_grasp(
            task,
            seed=seed,
            max_attempts=attempts,
            max_cpu_s=max_cpu_s,
            options=options,
            progress=show,
        )


def _folder_name(item: Any) -> str:
    """An object in the name of a folder: with its sizes, where it is told by sizes."""
    spec: str = item.shape.spec
    return item.name if "/" in spec or len(spec) > LONGEST_NAME else spec.replace(":", "-")


LONGEST_NAME = 60
"""Characters of an object in a folder's name."""


def _simulate(plan: Any, *, make: Any, physics: Any, view: bool, picture: Path | None) -> Any:
    """Execute with a progress bar on stderr."""
    from rich.progress import Progress

    from sim.trial import simulate

    with Progress(console=err, transient=True, disable=not err.is_terminal) as progress:
        bar = progress.add_task("simulating", total=1.0)
        return simulate(
            plan,
            physics=physics,
            controller=make(plan),
            progress=lambda share: progress.update(bar, completed=share),
            view=view,
            picture=picture,
        )


@errors_for_people()
def run(
    hand: HandArgument,
    object: ObjectArgument,
    out_dir: Annotated[
        Path | None, typer.Option("--out", help="Folder for plan, report and picture.")
    ] = None,
    fingers: FingersOption = None,
    seed: SeedOption = 0,
    mu: MuOption = 0.5,
    sim_mu: SimMuOption = None,
    physics: PhysicsOption = "ours",
    controller: ControllerOption = "feedforward",
    mass: MassOption = None,
    density: DensityOption = None,
    repair: RepairOption = False,
    pose: PoseOption = 0,
    touch: TouchOption = None,
    avoid: AvoidOption = None,
    expect_load: LoadOption = None,
    max_attempts: AttemptsOption = 100,
    max_cpu_s: CpuOption = None,
    objective: ObjectiveOption = "epsilon",
    task_wrench: TaskWrenchOption = None,
    rounds: RoundsOption = None,
    view: ViewOption = False,
    as_json: JsonOption = False,
) -> None:
    """Plan a grasp, distribute its forces, execute it, judge it; writes plan, report, picture."""
    from planner.files import plain_name, plan_to_dict, write_json, write_plan
    from sim.controllers import named_controller
    from sim.looking.viewer import check_display

    make_controller = named_controller(controller)
    computed = physics_of(physics, sim_mu)
    if out_dir is not None:
        make_folder(out_dir)
    if view:
        check_display()
    plan = _plan(
        hand,
        object,
        fingers=fingers,
        seed=seed,
        mu=mu,
        mass=mass,
        density=density,
        repair=repair,
        resting=pose,
        touch=touch,
        avoid=avoid,
        expect_load=expect_load,
        attempts=max_attempts,
        max_cpu_s=max_cpu_s,
        objective=objective,
        task_wrench=task_wrench,
        rounds=rounds,
    )
    spec = _folder_name(plan.task.object)
    folder = (
        out_dir or Path("runs") / f"{plain_name(plan.task.hand.name)}-{plain_name(spec)}-{seed}"
    )
    make_folder(folder)
    for old in ("report.json", "held.png"):  # of an earlier plan in this folder
        (folder / old).unlink(missing_ok=True)
    write_plan(plan, folder / "plan.json")
    if not as_json:
        say(out, escape(str(plan)))
    report = _simulate(
        plan, make=make_controller, physics=computed, view=view, picture=folder / "held.png"
    )
    write_json(report.to_dict(), folder / "report.json")
    if as_json:
        print_json({"plan": plan_to_dict(plan), "report": report.to_dict()})
    else:
        out.print(report)
        note = ", held.png" if report.picture else f" (no picture: {report.picture_reason})"
        say(out, escape(f"written to {folder}: plan.json, report.json{note}"))
    exit_for(report)


@errors_for_people()
def plan(
    hand: HandArgument,
    object: ObjectArgument,
    output: Annotated[Path, typer.Option("--out", "-o", help="The plan file.")] = Path("plan.json"),
    fingers: FingersOption = None,
    seed: SeedOption = 0,
    mu: MuOption = 0.5,
    mass: MassOption = None,
    density: DensityOption = None,
    repair: RepairOption = False,
    pose: PoseOption = 0,
    touch: TouchOption = None,
    avoid: AvoidOption = None,
    expect_load: LoadOption = None,
    max_attempts: AttemptsOption = 100,
    max_cpu_s: CpuOption = None,
    objective: ObjectiveOption = "epsilon",
    task_wrench: TaskWrenchOption = None,
    rounds: RoundsOption = None,
    as_json: JsonOption = False,
) -> None:
    """Plan a grasp and write it to a file."""
    from planner.files import plan_to_dict, write_plan

    check_folder(output)
    found = _plan(
        hand,
        object,
        fingers=fingers,
        seed=seed,
        mu=mu,
        mass=mass,
        density=density,
        repair=repair,
        resting=pose,
        touch=touch,
        avoid=avoid,
        expect_load=expect_load,
        attempts=max_attempts,
        max_cpu_s=max_cpu_s,
        objective=objective,
        task_wrench=task_wrench,
        rounds=rounds,
    )
    write_plan(found, output)
    if as_json:
        print_json(plan_to_dict(found))
    else:
        say(out, escape(str(found)))
        say(out, escape(f"written to {output}"))


@errors_for_people()
def simulate(
    plan_file: PlanArgument,
    report_file: Annotated[
        Path | None, typer.Option("--out", "-o", help="Write the trial report here.")
    ] = None,
    picture: Annotated[Path | None, typer.Option(help="Write a picture (PNG) here.")] = None,
    sim_mu: SimMuOption = None,
    physics: PhysicsOption = "ours",
    controller: ControllerOption = "feedforward",
    view: ViewOption = False,
    as_json: JsonOption = False,
) -> None:
    """Execute a plan file in MuJoCo: approach, close, squeeze, lift, hold; and judge it."""
    from planner.files import read_plan, write_json
    from sim.controllers import named_controller

    make_controller = named_controller(controller)
    computed = physics_of(physics, sim_mu)
    check_folder(report_file)
    check_folder(picture)
    report = _simulate(
        read_plan(plan_file), make=make_controller, physics=computed, view=view, picture=picture
    )
    if report_file is not None:
        write_json(report.to_dict(), report_file)
    if as_json:
        print_json(report.to_dict())
    else:
        out.print(report)
        if picture is not None:
            note = report.picture_reason or f"written to {picture}"
            say(out, escape(f"picture: {note}"))
    exit_for(report)


def register(app: typer.Typer) -> None:
    """Add the commands."""
    for command in (run, plan, simulate):
        app.command()(command)
