"""The command that shows anything in the browser: ``view``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

from sim.cli.common import check_folder, err, errors_for_people, out, say


@errors_for_people()
def view(
    what: Annotated[
        str,
        typer.Argument(
            help="A hand, an object or mesh, a plan, motion, gait or manipulation file, a report, "
            "or the folder of a batch or run.",
            metavar="WHAT",
        ),
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            "--out", "-o", help="Write the page here, no more; not for a dataset.", metavar="FILE"
        ),
    ] = None,
    port: Annotated[
        int | None,
        typer.Option(min=0, max=65535, help="Serve on this port; 0: any free one.", metavar="PORT"),
    ] = None,
    no_open: Annotated[
        bool, typer.Option("--no-open", help="Serve, and open no browser.", metavar="")
    ] = False,
    alternatives: Annotated[
        int, typer.Option(min=0, help="Of a plan: other grasps of its task.", metavar="N")
    ] = 0,
    touch: Annotated[
        list[str] | None,
        typer.Option(help="Of an object: where to touch it, z>0.01 (m).", metavar="REGION"),
    ] = None,
    avoid: Annotated[
        list[str] | None, typer.Option(help="Where not to touch it.", metavar="REGION")
    ] = None,
    repair: Annotated[
        bool,
        typer.Option("--repair", help="Mend a mesh however much that changes.", metavar=""),
    ] = False,
    strict: Annotated[
        bool, typer.Option("--strict", help="Refuse a mesh that would be mended.", metavar="")
    ] = False,
) -> None:
    """Show a hand, object, plan, run or dataset in the browser.

    The kind of file is recognised from its content. Without a display a server on 127.0.0.1 shows
    the page until Ctrl-C.
    """
    from planner.errors import TaskError
    from sim.viewing import Opening, Target, ViewOptions, recognise, show, warnings_of

    check_folder(output)
    target = Target(what)
    kind = recognise(target)
    given = {
        **{"alternatives": alternatives, "touch": touch, "avoid": avoid},
        **{"repair": repair, "strict": strict},
    }
    idle = [f"--{name}" for name, value in given.items() if value and name not in kind.takes]
    if idle:
        raise TaskError(f"{', '.join(idle)} means nothing for {kind.name}; leave it out")
    options = ViewOptions(
        alternatives=alternatives,
        touch=tuple(touch or ()),
        avoid=tuple(avoid or ()),
        repair=repair,
        strict=strict,
    )
    with err.status(escape(f"preparing {what} ...")):
        shown = kind.shown(target, options)
    for warning in warnings_of(shown):
        say(err, f"[yellow]{escape(warning)}[/]")
    opening = Opening(out=output, port=port, open=not no_open)
    show(shown, opening, lambda line: say(out, escape(line)))
