"""The commands ``plan-motion`` and ``plan-gait``: how an object is turned or moved in the hand."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

from sim.cli.common import (
    MOVEMENT_PANEL,
    SEARCH_PANEL,
    ArrowsOption,
    HandArgument,
    JsonOption,
    ObjectArgument,
    PictureOption,
    SeedOption,
    VideoOption,
    check_films,
    err,
    errors_for_people,
    numbers,
    out,
    print_json,
    say,
)
from sim.cli.movement import NO_SHIFT, ShiftOption
from sim.cli.options import AttemptsOption, with_options
from sim.cli.task_options import TaskOptions

AxisOption = Annotated[
    str,
    typer.Option(help="Axis of the turn, world.", metavar="X,Y,Z", rich_help_panel=MOVEMENT_PANEL),
]


@errors_for_people()
@with_options
def plan_motion(
    hand: HandArgument,
    object: ObjectArgument,
    output: Annotated[Path, typer.Option("--out", "-o", help="The motion file.")] = Path(
        "motion.json"
    ),
    angle: Annotated[
        float | None,
        typer.Option(
            help="Turn, degrees; the most there is if not given.",
            metavar="DEG",
            rich_help_panel=MOVEMENT_PANEL,
        ),
    ] = None,
    axis: AxisOption = "0,0,1",
    shift: ShiftOption = NO_SHIFT,
    path_tolerance: Annotated[
        float,
        typer.Option(
            help="How far it may leave its path, m.", metavar="M", rich_help_panel=MOVEMENT_PANEL
        ),
    ] = 0.02,
    seed: SeedOption = 0,
    max_attempts: AttemptsOption = 30,
    best_of: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Motions to find, of which the best is taken.",
            metavar="N",
            rich_help_panel=SEARCH_PANEL,
        ),
    ] = None,
    picture: PictureOption = None,
    video: VideoOption = None,
    arrows: ArrowsOption = False,
    as_json: JsonOption = False,
    *,
    asked: TaskOptions,
) -> None:
    """Plan how an object is turned or moved on one grasp."""
    from planner.files import write_motion
    from planner.files.movements import motion_to_dict
    from planner.motion import plan_motion as plan
    from sim.manipulation.drawing import draw_motion

    check_films(output, picture, video)
    task = asked.task(hand, object)
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
@with_options
def plan_gait(
    hand: HandArgument,
    object: ObjectArgument,
    output: Annotated[Path, typer.Option("--out", "-o", help="The gait file.")] = Path("gait.json"),
    angle: Annotated[
        float,
        typer.Option(
            help="Turn of any size, degrees.", metavar="DEG", rich_help_panel=MOVEMENT_PANEL
        ),
    ] = 0.0,
    axis: AxisOption = "0,0,1",
    shift: ShiftOption = NO_SHIFT,
    seed: SeedOption = 0,
    max_attempts: AttemptsOption = 30,
    picture: PictureOption = None,
    video: VideoOption = None,
    arrows: ArrowsOption = False,
    as_json: JsonOption = False,
    *,
    asked: TaskOptions,
) -> None:
    """Plan a turn of any size by strokes, fingers moving on."""
    from planner.files import write_gait
    from planner.files.movements import gait_to_dict
    from planner.motion.gait import plan_gait as plan
    from sim.manipulation.drawing import draw_motion

    check_films(output, picture, video)
    task = asked.task(hand, object)
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
