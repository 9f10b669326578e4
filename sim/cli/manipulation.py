"""Commands that turn an object in the hand: ``manipulate`` and its default, ``demo``."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.markup import escape

from sim.cli.common import (
    EXIT_NO,
    FingersOption,
    HandArgument,
    JsonOption,
    MassOption,
    ObjectArgument,
    PhysicsOption,
    SeedOption,
    SimMuOption,
    StandOption,
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

OutOption = Annotated[
    Path | None, typer.Option("--out", help="Folder for motion, report and a picture per phase.")
]

DEMO = {"hand": "allegro_hand", "object": "cylinder:0.03x0.08"}
"""What ``demo`` shows."""

MU, MAX_ATTEMPTS = 0.45, 50
"""Friction (-) that is believed, as in ``bench manipulate``: a tenth below the least that there is
there, 0.5, which planning alone believes. Attempts, more than planning
a motion alone makes (30): here motions are refused too at whose end the object cannot be put down,
and of those that are left the best of a few is taken."""


@errors_for_people()
def manipulate(
    hand: HandArgument,
    object: ObjectArgument,
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
            help="Largest normal force with which a finger may press for the strict verdict, N; "
            "half as much again as the plan's largest and a quarter, at least 18, if not given.",
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Pick an object from a table, turn it in the hand, put it down; a check after every phase.

    Where one stroke is not enough, fingers move on one at a time while the others hold. A turn that
    stalls is tried again, once. An object that does not stand as it was turned, or that the hand
    could not let go of where it was moved to, is brought back in the hand before it is put down.

    Exits with 1 where a phase failed, or where the hand collided with itself, the table or the
    stand.
    """
    _perform(
        hand,
        object,
        rotate=rotate,
        shift=shift,
        place=place,
        folder=out_dir,
        fingers=fingers,
        seed=seed,
        mu=mu,
        physics=physics_of(physics, sim_mu),
        mass=mass,
        stand=stand,
        max_attempts=max_attempts,
        gait=gait,
        max_force=max_force,
        as_json=as_json,
    )


@errors_for_people()
def demo(
    out_dir: OutOption = None, physics: PhysicsOption = "ours", as_json: JsonOption = False
) -> None:
    """The whole of it: an Allegro-type hand picks a cylinder, turns it by 90 degrees, places it."""
    _perform(
        DEMO["hand"],
        DEMO["object"],
        rotate=None,
        shift=NO_SHIFT,
        place="0.1,0.05",
        folder=out_dir,
        fingers=None,
        seed=0,
        mu=MU,
        physics=physics_of(physics),
        mass=None,
        stand=0.0,
        max_attempts=MAX_ATTEMPTS,
        gait=False,
        max_force=None,
        as_json=as_json,
    )


def _perform(
    hand: str,
    object: str,
    *,
    rotate: str | None,
    shift: str,
    place: str,
    folder: Path | None,
    fingers: str | None,
    seed: int,
    mu: float,
    physics: Any,
    mass: float | None,
    stand: float,
    max_attempts: int,
    gait: bool,
    max_force: float | None,
    as_json: bool,
) -> None:
    """Plan, execute, tell."""
    from planner.files import write_gait, write_json, write_motion
    from planner.motion.manipulation import manipulation_task, on_stand, plan_manipulation
    from planner.objects import parse_object
    from sim.manipulation import Bounds, rests, settled
    from sim.manipulation import manipulate as execute

    axis, degrees, moved = movement(rotate, shift)
    if physics.mu < mu:
        say(
            err,
            f"[yellow]--sim-mu {physics.mu:g} is less friction than is believed, --mu {mu:g}: plan "
            "and controller rely on what is not there, so expect slips and drops; give "
            f"--sim-mu {mu:g} or more, or a smaller --mu[/yellow]",
        )
    if folder is not None:
        make_folder(folder)
    task = manipulation_task(
        hand,
        parse_object(object, mass=mass),
        mu=mu,
        fingers=None if fingers is None else names(fingers),
    )
    task = settled(on_stand(task, stand) if stand else task)
    x, y = numbers("--place", place, 2)
    with err.status(f"planning: {task.hand.name}, {task.object.name} ..."):
        plan = plan_manipulation(
            task,
            axis=axis,
            angle=math.radians(degrees),
            shift=moved,
            place=(x, y),
            seed=seed,
            max_attempts=max_attempts,
            regrasp=gait,
            rests=rests,
        )
    if not as_json:
        say(out, escape(str(plan.gait or plan.motion)))
        say(out, f"planned in {plan.cpu_s:.2f} s of CPU, {plan.attempts} attempts")
        if plan.ending.back:
            say(out, escape(f"made backwards before it is put down: {plan.ending.back}"))
        say(out, "")
    with err.status("executing ..."):
        report = execute(
            plan,
            physics=physics,
            bounds=Bounds(normal_N=max_force),
            pictures=folder,
            retry=True,
        )
    if folder is not None:
        if plan.gait is None:
            write_motion(plan.motion, folder / "motion.json")
        else:
            write_gait(plan.gait, folder / "gait.json")
        write_json(report.to_dict(), folder / "report.json")
    if as_json:
        print_json(report.to_dict())
    else:
        say(out, escape(str(report)))
        if folder is not None:
            note = report.picture_reason and f" (no pictures: {report.picture_reason})"
            plan_file = "motion.json" if plan.gait is None else "gait.json"
            say(out, escape(f"written to {folder}: {plan_file}, report.json, pictures{note}"))
    if not report.complete or report.collision is not None:
        raise typer.Exit(EXIT_NO)


def register(app: typer.Typer) -> None:
    """Add the commands."""
    app.command()(manipulate)
    app.command()(demo)
