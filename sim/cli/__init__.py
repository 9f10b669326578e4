"""The command ``opposable``: thin; a command's module is imported when it is asked for.

Exit codes: 0 done and good; 1 done, and the answer is no (no closure, object not held); 2 wrong
usage; 3 bad input (an error that says what to do); 4 no grasp found; 130 interrupted.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from types import ModuleType
from typing import Annotated, Any

import typer

from sim.cli.common import EXIT_INTERRUPTED, EXIT_USAGE, out, say
from sim.cli.listing import Opposable, overview

__all__ = ["app", "main"]

OPENGL = "mujoco.rendering.classic.gl_context"
"""MuJoCo's module that loads a library of windows while MuJoCo is imported: 0.2 s of CPU. Commands
that draw open contexts of their own (``sim.show.painter``), and none needs this one."""

SWITCH = "MUJOCO_GL"
"""Environment variable that tells that module what to load."""


class _Unopened(SourceFileLoader):
    """Runs MuJoCo's module as if the user had switched OpenGL off."""

    def exec_module(self, module: ModuleType) -> None:
        given = os.environ.get(SWITCH)
        os.environ[SWITCH] = "disable"
        try:
            super().exec_module(module)
        finally:
            del os.environ[SWITCH]
            if given is not None:
                os.environ[SWITCH] = given


class _WithoutOpenGL:
    """Finds MuJoCo's module for ``_Unopened``; everything else is found as ever."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if fullname != OPENGL:
            return None
        spec = PathFinder.find_spec(fullname, path)
        if spec is not None and isinstance(spec.loader, SourceFileLoader):
            spec.loader = _Unopened(fullname, spec.loader.path)
        return spec


app = typer.Typer(
    cls=Opposable,
    help="Plan a multi-finger grasp, execute it in MuJoCo, judge both by one analysis.",
    invoke_without_command=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


def _say_version(asked: bool) -> None:
    if asked:
        from planner.system.package import written_by

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
    """Run the command line; ``arguments`` are ``sys.argv[1:]`` if None.

    A process that is a command imports MuJoCo without OpenGL; one that calls this with arguments
    may want to draw, and imports it whole.
    """
    if arguments is None:
        sys.meta_path.insert(0, _WithoutOpenGL())
    try:
        command: Callable[..., Any] = typer.main.get_command(app)
        command(args=arguments, prog_name="opposable")
    except KeyboardInterrupt:  # before a command began, or after it ended
        sys.exit(EXIT_INTERRUPTED)
