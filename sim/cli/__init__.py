"""The command ``opposable``: thin; a command's module is imported when it is asked for.

Exit codes: 0 done and good; 1 done, and the answer is no (no closure, object not held); 2 wrong
usage; 3 bad input (an error that says what to do); 4 no grasp found; 130 interrupted.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Annotated, Any

import typer

from sim.cli.common import EXIT_INTERRUPTED, EXIT_USAGE, out, say
from sim.cli.listing import Opposable, overview

__all__ = ["app", "main"]

app = typer.Typer(
    cls=Opposable,
    help="Plan a multi-finger grasp, execute it in MuJoCo, judge both by one analysis.",
    invoke_without_command=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


def _say_version(asked: bool) -> None:
    if asked:
        from planner.version import written_by

        typer.echo(written_by())
        raise typer.Exit


@app.callback()
def _opposable(
    context: typer.Context,
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_say_version, is_eager=True, help="Print the version.", metavar=""
        ),
    ] = False,
) -> None:
    if context.invoked_subcommand is None:
        say(out, overview(str(app.info.help)))
        raise typer.Exit(EXIT_USAGE)


def main(arguments: list[str] | None = None) -> None:
    """Run the command line; ``arguments`` are ``sys.argv[1:]`` if None."""
    try:
        command: Callable[..., Any] = typer.main.get_command(app)
        command(args=arguments, prog_name="opposable")
    except KeyboardInterrupt:  # before a command began, or after it ended
        sys.exit(EXIT_INTERRUPTED)
