"""``python -m benchmarks NAME``: tables that repeat the project's figures, in a checkout."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable
from importlib import import_module
from typing import Any

import typer

from benchmarks.bench import Options, carry_out
from sim.cli.common import EXIT_INTERRUPTED, errors_for_people
from sim.cli.options import with_options

NAMES = (
    "grasps",
    "whole",
    "synthesis",
    "limit",
    "objectives",
    "best",
    "walls",
    "clouds",
    "metrics",
    "trials",
    "tools",
    "scenes",
    "pomdar",
    "goals",
    "palm",
    "refine",
    "audit",
    "forces",
    "control",
    "motion",
    "manipulate",
    "errors",
    "physics",
    "touch",
    "dexgraspbench",
    "bimandexgraspbench",
    "exports",
    "drake",
    "zoo",
    "gallery",
)
"""Modules of this package that measure, in the order of the list."""


def app(names: Iterable[str] = NAMES) -> typer.Typer:
    """The command line with some measurements; only their modules are imported."""
    made = typer.Typer(
        help="Tables that repeat the project's figures.",
        no_args_is_help=True,
        add_completion=False,
        pretty_exceptions_enable=False,
    )
    made.callback()(_nothing)  # one command alone keeps its name
    for name in names:
        made.command(name)(_command(name))
    return made


def _nothing() -> None:
    """Tables that repeat the project's figures."""


def _command(name: str) -> Callable[..., None]:
    bench = import_module(f"benchmarks.{name}")

    def command(*, options: Options) -> None:
        carry_out(bench, options)

    command.__doc__ = (bench.__doc__ or "").partition("\n\n")[0]
    command.__annotations__["options"] = bench.Options
    return errors_for_people()(with_options(command))


def main() -> None:
    """Run a measurement."""
    asked = [name for name in sys.argv[1:2] if name in NAMES]
    try:
        command: Callable[..., Any] = typer.main.get_command(app(asked or NAMES))
        command(prog_name="python -m benchmarks")
    except KeyboardInterrupt:  # before a command began, or after it ended
        sys.exit(EXIT_INTERRUPTED)


if __name__ == "__main__":
    main()
