"""Commands that turn an object in the hand: ``manipulate`` and its default, ``demo``."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.markup import escape

from sim.cli.common import (
    EXIT_NO,
    GRIP_PANEL,
    MOVEMENT_PANEL,
    SEARCH_PANEL,
    TRIAL_PANEL,
    ArrowsOption,
    ControllerOption,
    EstimateOption,
    FingersOption,
    JointErrorOption,
    JsonOption,
    MassOption,
    PadsOption,
    PhysicsOption,
    RealityOption,
    RealitySeedOption,
    RepairOption,
    SeedOption,
    SimMuOption,
    StandOption,
    StrictOption,
    VideoOption,
    ViewOption,
    check_films,
    check_policy,
    controller_of,
    err,
    errors_for_people,
    estimate_of,
    make_folder,
    names,
    numbers,
    out,
    physics_of,
    print_json,
    reality_of,
    reckoning_with,
    say,
    told_command,
)
from sim.cli.movement import NO_SHIFT, RotateOption, ShiftOption, movement
from sim.cli.options import with_options
from sim.cli.places import object_of

if TYPE_CHECKING:
    from planner.motion.manipulation import ManipulationPlan

OutOption = Annotated[
    Path | None,
    typer.Option(
        "--out", help="Folder for plan, trajectory, report, its page, pictures.", metavar="DIR"
    ),
]

DEMO_HAND, DEMO_OBJECT = "allegro_hand", "cylinder:0.03x0.08"
"""What ``demo`` shows."""

MU, MAX_ATTEMPTS = 0.45, 50
"""Friction (-) that is believed, as in ``bench manipulate``: a tenth below the least that it draws,
0.5. Attempts, more than planning a motion alone makes (30): here motions are refused too at whose
end the object cannot be put down, and the best of a few is taken."""


@dataclass(frozen=True, kw_only=True)
class TurnOptions:
    """What a manipulation is planned with."""

    rotate: RotateOption = None
    shift: ShiftOption = NO_SHIFT
    place: Annotated[
        str,
        typer.Option(
            help="Where it is put, m; it stands at 0,0.",
            metavar="X,Y",
            rich_help_panel=MOVEMENT_PANEL,
        ),
    ] = "0.1,0.05"
    fingers: FingersOption = None
    seed: SeedOption = 0
    mu: Annotated[
        float,
        typer.Option(
            help="Sliding friction that is relied on (-).",
            metavar="MU",
            rich_help_panel=GRIP_PANEL,
        ),
    ] = MU
    mass: MassOption = None
    repair: RepairOption = False
    strict: StrictOption = False
    stand: StandOption = 0.0
    joint_error: JointErrorOption = None
    max_attempts: Annotated[
        int,
        typer.Option(
            min=1,
            help="Attempts before giving up.",
            metavar="N",
            rich_help_panel=SEARCH_PANEL,
        ),
    ] = MAX_ATTEMPTS
    gait: Annotated[
        bool,
        typer.Option(
            "--gait",
            help="Turn by strokes, fingers moving on between them.",
            metavar="",
            rich_help_panel=MOVEMENT_PANEL,
        ),
    ] = False

    @property
    def tells_the_task(self) -> bool:
        """Whether anything is given that a plan file holds."""
        options = (self.rotate, self.fingers, self.mass, self.joint_error)
        given = any(option is not None for option in options)
        mended = self.repair or self.strict
        return given or mended or self.shift != NO_SHIFT or self.stand > 0.0 or self.gait

    def target(self) -> tuple[float, float]:
        """Where the object is put (2,), m."""
        x, y = numbers("--place", self.place, 2)
        return x, y

    def plan(self, hand: str, object: str) -> ManipulationPlan:
        """Plan with a spinner on stderr.

        Raises:
            PlannerError: Bad input, or nothing was found.
        """
        from planner.errors import NoGraspFoundError
        from planner.motion.manipulation import manipulation_task, on_stand, plan_manipulation
        from planner.synthesis.options import SynthesisOptions
        from sim.cli.low_objects import advice_for_low, said_of_low
        from sim.manipulation import rests, settled

        axis, degrees, shift = movement(self.rotate, self.shift)
        task = manipulation_task(
            hand,
            object_of(object, mass=self.mass, repair=self.repair, strict=self.strict),
            mu=self.mu,
            fingers=None if self.fingers is None else names(self.fingers),
        )
        task = replace(task, joint_error=math.radians(self.joint_error or 0.0))
        task = settled(on_stand(task, self.stand) if self.stand else task)
        with err.status(f"planning: {task.hand.name}, {task.object.name} ..."):
            try:
                return plan_manipulation(
                    task,
                    axis=axis,
                    angle=math.radians(degrees),
                    shift=shift,
                    place=self.target(),
                    seed=self.seed,
                    max_attempts=self.max_attempts,
                    regrasp=self.gait,
                    rests=rests,
                )
            except NoGraspFoundError as error:
                advice = advice_for_low(
                    task,
                    pose=None,
                    options=SynthesisOptions(),
                    seed=self.seed,
                )
                if advice is None:
                    raise
                raise said_of_low(error, task, advice) from error


@dataclass(frozen=True, kw_only=True)
class ExecutionOptions:
    """How a manipulation is executed."""

    sim_mu: SimMuOption = None
    physics: PhysicsOption = "ours"
    reality: RealityOption = "ideal"
    reality_seed: RealitySeedOption = None
    estimate: EstimateOption = None
    pads: PadsOption = None
    max_force: Annotated[
        float | None,
        typer.Option(
            min=0.0,
            help="Largest normal force of a finger in a success with closure, N; 1.5 times the "
            "plan's largest and a quarter, at least 18, if not given.",
            metavar="N",
            rich_help_panel=TRIAL_PANEL,
        ),
    ] = None
    controller: ControllerOption = "impedance"
    view: ViewOption = False
    video: VideoOption = None
    arrows: ArrowsOption = False


@errors_for_people()
@with_options
def manipulate(
    context: typer.Context,
    hand: Annotated[
        str | None,
        typer.Argument(help="Its name, hand.toml, MJCF or URDF file.", metavar="HAND"),
    ] = None,
    object: Annotated[
        str | None, typer.Argument(help="The object, as for run.", metavar="OBJECT")
    ] = None,
    plan_file: Annotated[
        Path | None,
        typer.Option(
            "--plan",
            help="Execute this manipulation, motion or gait instead of planning one.",
            metavar="FILE",
        ),
    ] = None,
    *,
    request: TurnOptions,
    execution: ExecutionOptions,
    out_dir: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Pick an object up, turn it in the hand, put it down.

    Where one stroke is not enough, fingers move on one at a time while the others hold. A turn that
    stalls is tried again, once. An object that does not stand as it was turned, or that the hand
    could not let go of where it was moved to, is brought back in the hand before it is put down.

    Exit code 1 if a phase failed, or if the hand collided with itself, the table or the
    stand.
    """
    from planner.errors import TaskError
    from planner.objects import parse_object

    if plan_file is None:
        if hand is None or object is None:
            raise TaskError("give HAND and OBJECT, or a file: opposable manipulate --plan FILE")
        hand_name, object_name = hand, object
        axis, degrees, shift = movement(request.rotate, request.shift)
        upright = axis == (0.0, 0.0, 1.0) and not any(shift)
        asked = degrees if upright else None
        check_policy(execution, hand, lambda: parse_object(object_name, mass=request.mass), asked)
        _execute(
            lambda: reckoning_with(request, execution.reality).plan(hand_name, object_name),
            request.mu,
            execution,
            out_dir,
            as_json,
            told_command(context),
        )
        return
    if hand is not None or object is not None or request.tells_the_task:
        raise TaskError(
            f"{plan_file} tells hand, object and movement; leave HAND, OBJECT and the options "
            "of planning out, or --plan"
        )
    plan = _read(plan_file, request.target())
    degrees = math.degrees(plan.angle)
    check_policy(execution, plan.task.hand, lambda: plan.task.object, degrees)
    command = told_command(context)
    _execute(lambda: plan, plan.task.mu, execution, out_dir, as_json, command)


@errors_for_people()
def demo(
    context: typer.Context,
    out_dir: OutOption = None,
    physics: PhysicsOption = "ours",
    video: VideoOption = None,
    arrows: ArrowsOption = False,
    as_json: JsonOption = False,
) -> None:
    """An Allegro-type hand turns a cylinder by 90 degrees."""
    request = TurnOptions()
    execution = ExecutionOptions(physics=physics, video=video, arrows=arrows)
    _execute(
        lambda: request.plan(DEMO_HAND, DEMO_OBJECT),
        request.mu,
        execution,
        out_dir,
        as_json,
        told_command(context),
    )


def _execute(
    make_plan: Callable[[], ManipulationPlan],
    believed_mu: float,
    execution: ExecutionOptions,
    out_dir: Path | None,
    as_json: bool,
    command: str,
) -> None:
    """Plan once all other options are known to be sound, execute, and report.

    Raises:
        PlannerError: Bad input, or no plan.
        Exit: A phase failed, or the hand collided.
    """
    from planner.files import write_manipulation, write_trajectory
    from sim.manipulation import SuccessCriteria
    from sim.manipulation import manipulate as simulate
    from sim.report_file import write_report

    physics = physics_of(execution.physics, execution.sim_mu)
    reality = reality_of(execution.reality, execution.reality_seed, execution.pads)
    estimator = estimate_of(execution.estimate)
    driver = controller_of(execution.controller)
    check_films(execution.video)
    _warn_of_friction(believed_mu, physics.mu)
    if out_dir is not None:
        make_folder(out_dir)
    plan = make_plan()
    if not as_json:
        say(out, escape(str(plan)))
        say(out, f"planned in {plan.cpu_s:.2f} s of CPU, {plan.attempts} attempts\n")
    with err.status("executing ..."):
        report = simulate(
            plan,
            controller=driver,
            physics=physics,
            reality=reality,
            estimator=estimator,
            criteria=SuccessCriteria(normal_N=execution.max_force),
            pictures=out_dir,
            video=execution.video,
            arrows=execution.arrows,
            retry=True,
            view=execution.view,
        )
    report = replace(report, command=command)
    if out_dir is not None:
        write_manipulation(plan, out_dir / "manipulation.json")
        write_trajectory(plan.joint_trajectory(), out_dir / "trajectory.csv")
        write_report(report.to_dict(), out_dir / "report.json")
        report.save_html(out_dir / "report.html")
    if as_json:
        print_json(report.to_dict())
    else:
        say(out, escape(str(report)))
        if out_dir is not None:
            files = "manipulation.json, trajectory.csv, report.json"
            say(out, escape(f"written to {out_dir}: {files}"))
            say(out, escape(f"open in a browser: {out_dir / 'report.html'}"))
        if report.drawn:
            say(out, escape(report.drawn))
    if not report.complete or report.collision is not None:
        raise typer.Exit(EXIT_NO)


def _warn_of_friction(believed: float, true: float) -> None:
    """Tell when there is less friction than planning relies on."""
    if true < believed:
        say(
            err,
            f"[yellow]--sim-mu {true:g} is less friction than is believed, --mu {believed:g}: plan "
            "and controller rely on what is not there, so expect slips and drops; give "
            f"--sim-mu {believed:g} or more, or a smaller --mu[/yellow]",
        )


def _read(file: Path, place: tuple[float, float]) -> ManipulationPlan:
    """The manipulation of a file, which may be a motion or a gait that is put down at a place."""
    from planner.files import read_gait, read_json, read_manipulation, read_motion
    from planner.motion.manipulation import manipulation_of
    from sim.manipulation import rests

    kind = read_json(file, "plan file").get("format")
    if kind == "opposable-motion":
        return manipulation_of(read_motion(file), place=place, rests=rests)
    if kind == "opposable-gait":
        return manipulation_of(read_gait(file), place=place, rests=rests)
    return read_manipulation(file)
