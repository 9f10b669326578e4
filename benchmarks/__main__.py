"""``python -m benchmarks NAME``: tables that repeat the project's figures, in a checkout."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import typer

from benchmarks.commands import app
from sim.cli.common import EXIT_INTERRUPTED


def main() -> None:
    """Run a measurement."""
    try:
        command: Callable[..., Any] = typer.main.get_command(app)
        command(prog_name="python -m benchmarks")
    except KeyboardInterrupt:  # before a command began, or after it ended
        sys.exit(EXIT_INTERRUPTED)


if __name__ == "__main__":
    main()
