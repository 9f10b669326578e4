"""The command ``bench pages``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from benchmarks.commands.common import ResultOptions
from sim.cli.common import errors_for_people, make_folder
from sim.cli.options import SeedOption, with_options


@errors_for_people()
@with_options
def pages(
    n: Annotated[int, typer.Option("-n", "--number", min=1, help="How many pages.")] = 20,
    seed: SeedOption = 0,
    folder: Annotated[
        Path | None, typer.Option(help="Keep the pages here; they are deleted otherwise.")
    ] = None,
    samples: Annotated[
        Path | None,
        typer.Option(help="Results go here as they come; goes on where it ended."),
    ] = None,
    *,
    result: ResultOptions,
) -> None:
    """Pages of random reports in a headless browser: errors, requests, poses, time and size."""
    from benchmarks.pages import pages_table, run_pages

    if folder is not None:
        make_folder(folder)
    with result.measuring(samples) as runner:
        measured = run_pages(n, seed=seed, folder=folder, file=samples, runner=runner)
    result.give(measured, pages_table)
