"""The command ``opposable``: thin; every subcommand imports what it needs when it runs.

Exit codes: 0 done and good; 1 done, and the answer is no (no closure, object not held); 2 wrong
usage; 3 bad input (an error that says what to do); 4 no grasp found; 130 interrupted.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import typer

from sim.cli.common import EXIT_BAD_INPUT, EXIT_INTERRUPTED, EXIT_USAGE, err, out, say
from sim.cli.listing import GROUPS, MEASURE, overview, register

__all__ = ["app", "main"]

app = typer.Typer(
    help="Plan a multi-finger grasp, execute it in MuJoCo, judge both by one analysis.",
    epilog="Examples:\n" + "\n".join(f"  {group[0].example}" for group in GROUPS.values()),
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
        say(out, overview(app))
        raise typer.Exit(EXIT_USAGE)


CHECKOUT = Path(__file__).resolve().parents[2]
"""Where this code lies; in a checkout the commands that measure lie beside it."""

NEEDS_CHECKOUT = (
    "[bold red]error:[/] measuring needs a checkout: clone the repository, run "
    "`pip install -e .` in it, and repeat the command"
)
"""What ``bench`` answers in a wheel."""


def _no_bench() -> None:
    """Tables that repeat the project's figures (in a checkout only)."""
    say(err, NEEDS_CHECKOUT)
    raise typer.Exit(EXIT_BAD_INPUT)


def _register_bench() -> None:
    """Add the group ``bench``, or in a wheel one command that says where to find it."""
    if (CHECKOUT / "pyproject.toml").is_file():
        import_module("benchmarks.commands").register(app, MEASURE)
        return
    anything = {"allow_extra_args": True, "ignore_unknown_options": True, "help_option_names": []}
    app.command("bench", context_settings=anything, rich_help_panel=MEASURE)(_no_bench)


register(app)
_register_bench()


def main(arguments: list[str] | None = None) -> None:
    """Run the command line; ``arguments`` are ``sys.argv[1:]`` if None."""
    try:
        command: Callable[..., Any] = typer.main.get_command(app)
        command(args=arguments, prog_name="opposable")
    except KeyboardInterrupt:  # before a command began, or after it ended
        sys.exit(EXIT_INTERRUPTED)
