"""Commands that turn an object in the hand: ``manipulate`` and its default, ``demo``."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.markup import escape

from sim.cli.common import (
    EXIT_NO,
    ControllerOption,
    FingersOption,
    JsonOption,
    MassOption,
    PhysicsOption,
    SeedOption,
    SimMuOption,
    StandOption,
    ViewOption,
    err,
    errors_for_people,
    make_folder,
    names,
    numbers,
    out,
    physics_of,
    print_json,
    say,
)
from sim.cli.movement import NO_SHIFT, RotateOption, ShiftOption, movement

if TYPE_CHECKING:
    from planner.motion.manipulation import ManipulationPlan

OutOption = Annotated[
    Path | None,
    typer.Option("--out", help="Folder for plan, trajectory, report and a picture per phase."),
]

DEMO_HAND, DEMO_OBJECT = "allegro_hand", "cylinder:0.03x0.08"
"""What ``demo`` shows."""

MU, MAX_ATTEMPTS = 0.45, 50
"""Friction (-) that is believed, as in ``bench manipulate``: a tenth below the least that it draws,
0.5. Attempts, more than planning a motion alone makes (30): here motions are refused too at whose
end the object cannot be put down, and the best of a few is taken."""


@errors_for_people()
def manipulate(
    hand: Annotated[
        str | None,
        typer.Argument(
            help="A hand's name, or the path of its hand.toml or of an MJCF or URDF file.",
            metavar="HAND",
        ),
    ] = None,
    object: Annotated[
        str | None, typer.Argument(help="The object, as for run.", metavar="OBJECT")
    ] = None,
    plan_file: Annotated[
        Path | None,
        typer.Option(
            "--plan",
            help="Execute this manipulation file, or a motion or gait file, which is put down at "
            "--place; instead of HAND, OBJECT and what planning is told.",
        ),
    ] = None,
    rotate: RotateOption = None,
    shift: ShiftOption = NO_SHIFT,
    place: Annotated[
        str, typer.Option(help="Where the object is put, m: x,y; it stands at 0,0.")
    ] = "0.1,0.05",
    out_dir: OutOption = None,
    fingers: FingersOption = None,
    seed: SeedOption = 0,
    mu: Annotated[
        float,
        typer.Option(
            help="Sliding friction that planning relies on (-); 0.45 is a tenth below the least "
            "that bench manipulate draws, whose figures hold for it. Planning alone takes 0.5."
        ),
    ] = MU,
    sim_mu: SimMuOption = None,
    physics: PhysicsOption = "ours",
    mass: MassOption = None,
    stand: StandOption = 0.0,
    max_attempts: Annotated[
        int,
        typer.Option(
            min=1,
            help="Attempts before giving up; more than the 30 of plan-motion, since motions are "
            "refused too at whose end the object cannot be put down.",
        ),
    ] = MAX_ATTEMPTS,
    gait: Annotated[
        bool,
        typer.Option(
            "--gait", help="Turn by strokes, the fingers moving on between them, in any case."
        ),
    ] = False,
    max_force: Annotated[
        float | None,
        typer.Option(
            min=0.0,
            help="Largest normal force of a finger in a success with closure, N; if not given, "
            "1.5 times the plan's largest force and a quarter, at least 18.",
        ),
    ] = None,
    controller: ControllerOption = "impedance",
    view: ViewOption = False,
    as_json: JsonOption = False,
) -> None:
    """Pick an object from a table, turn it in the hand, put it down; a check after every phase.

    Where one stroke is not enough, fingers move on one at a time while the others hold. A turn that
    stalls is tried again, once. An object that does not stand as it was turned, or that the hand
    could not let go of where it was moved to, is brought back in the hand before it is put down.

    Exits with 1 where a phase failed, or where the hand collided with itself, the table or the
    stand.
    """
    from planner.errors import TaskError
    from planner.files import write_json, write_manipulation, write_trajectory
    from sim.manipulation import SuccessCriteria
    from sim.manipulation import manipulate as execute

    computed = physics_of(physics, sim_mu)
    x, y = numbers("--place", place, 2)
    planning = (hand, object, rotate, fingers, mass)
    if plan_file is not None:
        if any(given is not None for given in planning) or shift != NO_SHIFT or stand or gait:
            raise TaskError(
                f"{plan_file} tells hand, object and movement; leave HAND, OBJECT and the options "
                "of planning out, or --plan"
            )
        plan = _read(plan_file, (x, y))
        mu = plan.task.mu
    elif hand is None or object is None:
        raise TaskError("give HAND and OBJECT, or a file: opposable manipulate --plan FILE")
    _warn_of_friction(mu, computed.mu)
    if out_dir is not None:
        make_folder(out_dir)
    if plan_file is None:
        plan = _plan(
            str(hand),
            str(object),
            movement(rotate, shift),
            place=(x, y),
            fingers=fingers,
            seed=seed,
            mu=mu,
            mass=mass,
            stand=stand,
            max_attempts=max_attempts,
            regrasp=gait,
        )
    if not as_json:
        say(out, escape(str(plan)))
        say(out, f"planned in {plan.cpu_s:.2f} s of CPU, {plan.attempts} attempts\n")
    with err.status("executing ..."):
        report = execute(
            plan,
            controller=controller,
            physics=computed,
            criteria=SuccessCriteria(normal_N=max_force),
            pictures=out_dir,
            retry=True,
            view=view,
        )
    if out_dir is not None:
        write_manipulation(plan, out_dir / "manipulation.json")
        write_trajectory(plan.joint_trajectory(), out_dir / "trajectory.csv")
        write_json(report.to_dict(), out_dir / "report.json")
    if as_json:
        print_json(report.to_dict())
    else:
        say(out, escape(str(report)))
        if out_dir is not None:
            note = report.picture_reason and f" (no pictures: {report.picture_reason})"
            files = "manipulation.json, trajectory.csv, report.json, pictures"
            say(out, escape(f"written to {out_dir}: {files}{note}"))
    if not report.complete or report.collision is not None:
        raise typer.Exit(EXIT_NO)


@errors_for_people()
def demo(
    out_dir: OutOption = None, physics: PhysicsOption = "ours", as_json: JsonOption = False
) -> None:
    """The whole of it: an Allegro-type hand picks a cylinder, turns it by 90 degrees, places it."""
    manipulate(DEMO_HAND, DEMO_OBJECT, out_dir=out_dir, physics=physics, as_json=as_json)


def _warn_of_friction(believed: float, true: float) -> None:
    """Tell when there is less friction than planning relies on."""
    if true < believed:
        say(
            err,
            f"[yellow]--sim-mu {true:g} is less friction than is believed, --mu {believed:g}: plan "
            "and controller rely on what is not there, so expect slips and drops; give "
            f"--sim-mu {believed:g} or more, or a smaller --mu[/yellow]",
        )


def _plan(
    hand: str,
    object: str,
    moved: tuple[Any, float, Any],
    *,
    place: tuple[float, float],
    fingers: str | None,
    seed: int,
    mu: float,
    mass: float | None,
    stand: float,
    max_attempts: int,
    regrasp: bool,
) -> ManipulationPlan:
    """Plan what the options tell."""
    from planner.motion.manipulation import manipulation_task, on_stand, plan_manipulation
    from planner.objects import parse_object
    from sim.manipulation import rests, settled

    axis, degrees, shift = moved
    task = manipulation_task(
        hand,
        parse_object(object, mass=mass),
        mu=mu,
        fingers=None if fingers is None else names(fingers),
    )
    task = settled(on_stand(task, stand) if stand else task)
    with err.status(f"planning: {task.hand.name}, {task.object.name} ..."):
        return plan_manipulation(
            task,
            axis=axis,
            angle=math.radians(degrees),
            shift=shift,
            place=place,
            seed=seed,
            max_attempts=max_attempts,
            regrasp=regrasp,
            rests=rests,
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


def register(app: typer.Typer) -> None:
    """Add the commands."""
    app.command()(manipulate)
    app.command()(demo)
