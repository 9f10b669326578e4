"""The commands ``plan-motion`` and ``plan-gait``: how an object is turned or moved in the hand."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

from sim.cli.common import (
    ArrowsOption,
    FingersOption,
    HandArgument,
    JsonOption,
    MassOption,
    MuOption,
    ObjectArgument,
    PictureOption,
    SeedOption,
    VideoOption,
    check_films,
    err,
    errors_for_people,
    names,
    numbers,
    out,
    print_json,
    say,
)


@errors_for_people()
def plan_motion(
    hand: HandArgument,
    object: ObjectArgument,
    output: Annotated[Path, typer.Option("--out", "-o", help="The motion file.")] = Path(
        "motion.json"
    ),
    angle: Annotated[
        float | None,
        typer.Option(help="Turn, degrees, with its sign; as much as there is if not given."),
    ] = None,
    axis: Annotated[str, typer.Option(help="Axis of the turn, world: x,y,z.")] = "0,0,1",
    shift: Annotated[
        str, typer.Option(help="Translation of the object, m, world: x,y,z.")
    ] = "0,0,0",
    path_tolerance: Annotated[
        float, typer.Option(help="How far the object may leave its path, m.")
    ] = 0.02,
    fingers: FingersOption = None,
    seed: SeedOption = 0,
    mu: MuOption = 0.5,
    mass: MassOption = None,
    max_attempts: Annotated[int, typer.Option(min=1, help="Attempts before giving up.")] = 30,
    best_of: Annotated[
        int | None, typer.Option(min=1, help="Attempts of which the best is taken.")
    ] = None,
    picture: PictureOption = None,
    video: VideoOption = None,
    arrows: ArrowsOption = False,
    as_json: JsonOption = False,
) -> None:
    """Plan how an object is turned or moved in the hand on one grasp, and write it to a file."""
    from planner.files import write_motion
    from planner.files.motions import motion_to_dict
    from planner.motion import plan_motion as plan
    from planner.objects import parse_object
    from planner.task import GraspTask
    from sim.manipulation.drawing import draw_motion

    check_films(output, picture, video)
    task = GraspTask.create(
        hand,
        parse_object(object, mass=mass),
        mu=mu,
        fingers=None if fingers is None else names(fingers),
    )
    with err.status(f"planning: {task.hand.name}, {task.object.name} ..."):
        found = plan(
            task,
            axis=numbers("--axis", axis, 3),
            angle=None if angle is None else math.radians(angle),
            shift=numbers("--shift", shift, 3),
            path_tolerance=path_tolerance,
            seed=seed,
            max_attempts=max_attempts,
            best_of=best_of,
        )
    write_motion(found, output)
    drawn = ""
    if picture is not None or video is not None:
        drawn = draw_motion(found, picture=picture, video=video, arrows=arrows)
    if as_json:
        print_json(motion_to_dict(found))
    else:
        say(out, escape(str(found)))
        say(out, escape(f"written to {output}"))
        if drawn:
            say(out, escape(drawn))


@errors_for_people()
def plan_gait(
    hand: HandArgument,
    object: ObjectArgument,
    output: Annotated[Path, typer.Option("--out", "-o", help="The gait file.")] = Path("gait.json"),
    angle: Annotated[float, typer.Option(help="Turn, degrees, with its sign, of any size.")] = 0.0,
    axis: Annotated[str, typer.Option(help="Axis of the turn, world: x,y,z.")] = "0,0,1",
    shift: Annotated[
        str, typer.Option(help="Translation of the object, m, world: x,y,z.")
    ] = "0,0,0",
    fingers: FingersOption = None,
    seed: SeedOption = 0,
    mu: MuOption = 0.5,
    mass: MassOption = None,
    max_attempts: Annotated[int, typer.Option(min=1, help="Attempts before giving up.")] = 30,
    picture: PictureOption = None,
    video: VideoOption = None,
    arrows: ArrowsOption = False,
    as_json: JsonOption = False,
) -> None:
    """Plan how fingers move on, one at a time, to turn or move an object without end."""
    from planner.files import write_gait
    from planner.files.gaits import gait_to_dict
    from planner.motion.gait import plan_gait as plan
    from planner.objects import parse_object
    from planner.task import GraspTask
    from sim.manipulation.drawing import draw_motion

    check_films(output, picture, video)
    task = GraspTask.create(
        hand,
        parse_object(object, mass=mass),
        mu=mu,
        fingers=None if fingers is None else names(fingers),
    )
    with err.status(f"planning: {task.hand.name}, {task.object.name} ..."):
        found = plan(
            task,
            axis=numbers("--axis", axis, 3),
            angle=math.radians(angle),
            shift=numbers("--shift", shift, 3),
            seed=seed,
            max_attempts=max_attempts,
        )
    write_gait(found, output)
    drawn = ""
    if picture is not None or video is not None:
        drawn = draw_motion(found, picture=picture, video=video, arrows=arrows)
    if as_json:
        print_json(gait_to_dict(found))
    else:
        say(out, escape(str(found)))
        say(out, escape(f"written to {output}"))
        if drawn:
            say(out, escape(drawn))


def register(app: typer.Typer) -> None:
    """Add the commands."""
    app.command("plan-motion")(plan_motion)
    app.command("plan-gait")(plan_gait)
