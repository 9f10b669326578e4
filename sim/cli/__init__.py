"""The command ``opposable``: thin; every subcommand imports what it needs when it runs.

Exit codes: 0 done and good; 1 done, and the answer is no (no closure, object not held); 2 wrong
usage; 3 bad input (an error that says what to do); 4 no grasp found; 130 interrupted.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec
from typing import Annotated, Any

import typer

from sim.cli import (
    batch,
    certify,
    creep,
    crosscheck,
    forces,
    grasp,
    hands,
    look,
    manipulation,
    motion,
    test,
    view,
)
from sim.cli.common import EXIT_BAD_INPUT, EXIT_INTERRUPTED, err, say

__all__ = ["app", "main"]

app = typer.Typer(
    help="Plan a multi-finger grasp, execute it in MuJoCo, and judge both by the same analysis.",
    no_args_is_help=True,
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
    version: Annotated[
        bool, typer.Option("--version", callback=_say_version, is_eager=True, help="Say which.")
    ] = False,
) -> None:
    """Plan a multi-finger grasp, execute it in MuJoCo, and judge both by the same analysis."""


MEASURING = "sim.cli.bench"
"""The commands that measure; a wheel leaves them out, with ``sim.bench``."""

NEEDS_CHECKOUT = (
    "[bold red]error:[/] measuring needs a checkout: clone the repository, run "
    "`pip install -e .` in it, and repeat the command"
)
"""What ``bench`` answers in a wheel."""


def _no_bench() -> None:
    """Measure: tables that repeat the project's figures (in a checkout only)."""
    say(err, NEEDS_CHECKOUT)
    raise typer.Exit(EXIT_BAD_INPUT)


def _register_bench() -> None:
    """Add the group ``bench``, or in a wheel one command that says where to find it."""
    if find_spec(MEASURING) is not None:
        import_module(MEASURING).register(app)
        return
    anything = {"allow_extra_args": True, "ignore_unknown_options": True, "help_option_names": []}
    app.command("bench", context_settings=anything)(_no_bench)


for group in (
    grasp,
    motion,
    manipulation,
    batch,
    hands,
    look,
    view,
    certify,
    forces,
    crosscheck,
):
    group.register(app)
_register_bench()
for group in (test, creep):
    group.register(app)


def main(arguments: list[str] | None = None) -> None:
    """Run the command line; ``arguments`` are ``sys.argv[1:]`` if None."""
    try:
        command: Callable[..., Any] = typer.main.get_command(app)
        command(args=arguments, prog_name="opposable")
    except KeyboardInterrupt:  # before a command began, or after it ended
        sys.exit(EXIT_INTERRUPTED)
