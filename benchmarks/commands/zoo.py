"""Commands that make the hand zoo and the gallery of the documentation."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from benchmarks.commands.common import ResultOptions, SamplesOption
from sim.cli.common import errors_for_people, make_folder
from sim.cli.options import with_options


@errors_for_people()
@with_options
def zoo(
    hands: Annotated[
        list[str] | None,
        typer.Argument(help="Hands of the zoo; all if none is named.", metavar="[HAND]..."),
    ] = None,
    models: Annotated[
        Path,
        typer.Option(help="Folder of clones, OWNER/NAME, of the repositories in the list."),
    ] = Path("models-of-others"),
    listed: Annotated[
        Path | None, typer.Option("--list", help="List of models; docs/zoo/models.toml if none.")
    ] = None,
    pictures: Annotated[
        Path | None, typer.Option(help="Folder for thumbnails; no pictures if none.")
    ] = None,
    cpu_s: Annotated[
        float, typer.Option(min=0.0, help="CPU seconds per hand, then no further try.")
    ] = 20.0,
    every: Annotated[
        bool,
        typer.Option("--every-shape", help="Box, cylinder and sphere are to be held.", metavar=""),
    ] = False,
    samples: SamplesOption = Path("zoo.jsonl"),
    *,
    result: ResultOptions,
) -> None:
    """Describe, check and try every hand of the zoo: a grasp that held, or why none did."""
    from benchmarks.zoo.measure import run_zoo
    from benchmarks.zoo.models import MODELS_FILE, chosen, zoo_models
    from benchmarks.zoo.table import zoo_tables

    wanted = chosen(zoo_models(listed or MODELS_FILE), hands or [])
    if pictures is not None:
        make_folder(pictures)
    with result.measuring(samples) as runner:
        measured = run_zoo(
            wanted,
            folder=models,
            pictures=pictures,
            cpu_s=cpu_s,
            file=samples,
            runner=runner,
            every=every,
        )
    result.give(measured, zoo_tables)


@errors_for_people()
@with_options
def gallery(
    entries: Annotated[
        list[str] | None,
        typer.Argument(help="Entries of the gallery; all if none is named.", metavar="[ENTRY]..."),
    ] = None,
    pictures: Annotated[Path, typer.Option(help="Folder for films and pictures.")] = Path(
        "docs/gallery/pictures"
    ),
    pages: Annotated[
        Path | None, typer.Option(help="Folder for pages with 3D scenes; no pages if none.")
    ] = None,
    samples: SamplesOption = Path("gallery.jsonl"),
    *,
    result: ResultOptions,
) -> None:
    """Run every example and film it: the gallery of the documentation."""
    from benchmarks.gallery.entries import chosen, gallery_entries
    from benchmarks.gallery.make import run_gallery
    from benchmarks.gallery.table import gallery_table

    wanted = chosen(gallery_entries(), entries or [])
    for folder in filter(None, (pictures, pages)):
        make_folder(folder)
    with result.measuring(samples) as runner:
        made = run_gallery(wanted, pictures=pictures, pages=pages, file=samples, runner=runner)
    result.give(made, gallery_table)
