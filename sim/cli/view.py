"""The command that shows anything in the browser: ``view``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

from sim.cli.common import (
    AvoidOption,
    RepairOption,
    TouchOption,
    check_folder,
    err,
    errors_for_people,
    out,
    say,
)


@errors_for_people()
def view(
    what: Annotated[
        str,
        typer.Argument(
            help="A hand (name, hand.toml, MJCF or URDF), an object or mesh, a plan, motion, gait "
            "or manipulation file, a report (JSON or HTML), or the folder of a batch.",
            metavar="WHAT",
        ),
    ],
    output: Annotated[
        Path | None, typer.Option("--out", "-o", help="Write the page into this file, no more.")
    ] = None,
    port: Annotated[
        int | None,
        typer.Option(min=0, max=65535, help="Serve on this port of 127.0.0.1; 0 for a free one."),
    ] = None,
    no_open: Annotated[bool, typer.Option("--no-open", help="Serve, and open no browser.")] = False,
    alternatives: Annotated[
        int, typer.Option(min=0, help="Of a plan: further grasps to plan and show beside it.")
    ] = 0,
    touch: TouchOption = None,
    avoid: AvoidOption = None,
    repair: RepairOption = False,
) -> None:
    """Show hands, objects, plans, motions, reports in a browser."""
    from planner.errors import TaskError
    from sim.viewing import Opening, Target, ViewOptions, recognise, show

    check_folder(output)
    target = Target(what)
    kind = recognise(target)
    given = {"alternatives": alternatives, "touch": touch, "avoid": avoid, "repair": repair}
    idle = [f"--{name}" for name, value in given.items() if value and name not in kind.takes]
    if idle:
        raise TaskError(f"{', '.join(idle)} means nothing for {kind.name}; leave it out")
    options = ViewOptions(
        alternatives=alternatives,
        touch=tuple(touch or ()),
        avoid=tuple(avoid or ()),
        repair=repair,
    )
    with err.status(escape(f"preparing {what} ...")):
        shown = kind.shown(target, options)
    opening = Opening(out=output, port=port, open=not no_open)
    show(shown, opening, lambda line: say(out, escape(line)))
