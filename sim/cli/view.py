"""The command that shows anything in the browser: ``view``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from rich.markup import escape

from sim.cli.common import check_folder, err, say, tell
from sim.cli.options import argument, command, flag, option


@command
def view(
    what: Annotated[
        str,
        argument(
            "A hand, an object or mesh, a plan, motion, gait or manipulation file, a report, or "
            "the folder of a batch or run.",
            "WHAT",
        ),
    ],
    output: Annotated[
        Path | None,
        option("Write the page here, no more; not for a dataset.", "FILE", None, "--out", "-o"),
    ] = None,
    port: Annotated[
        int | None,
        option("Serve on this port; 0: any free one.", "PORT", min=0, max=65535),
    ] = None,
    alternatives: Annotated[int, option("Of a plan: other grasps of its task.", "N", min=0)] = 0,
    touch: Annotated[
        list[str] | None, option("Of an object: where to touch it, z>0.01 (m).", "REGION")
    ] = None,
    avoid: Annotated[list[str] | None, option("Where not to touch it.", "REGION")] = None,
    repair: Annotated[bool, flag("--repair", "Mend a mesh however much that changes.")] = False,
    strict: Annotated[bool, flag("--strict", "Refuse a mesh that would be mended.")] = False,
) -> None:
    """Show a hand, object, plan, run or dataset in the browser.

    The kind of file is recognised from its content. Without a display a server on 127.0.0.1 shows
    the page until Ctrl-C.
    """
    from planner.errors import TaskError
    from sim.show.browser import Opening, show, warnings_of
    from sim.show.targets import Target, ViewOptions, recognise

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
    opening = Opening(out=output, port=port)
    show(shown, opening, tell)
