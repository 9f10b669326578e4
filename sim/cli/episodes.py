"""The command ``episodes``."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.markup import escape

from sim.cli.common import (
    EXIT_INTERRUPTED,
    TRIAL_PANEL,
    JsonOption,
    PhysicsOption,
    SimMuOption,
    err,
    errors_for_people,
    heeding_ctrl_c,
    out,
    physics_of,
    print_json,
    say,
)

if TYPE_CHECKING:
    from sim.episodes import AnyReport, Episode


@errors_for_people()
def episodes(
    inputs: Annotated[
        list[Path],
        typer.Argument(help="Plans, reports, folders of plans or of batches.", metavar="INPUT..."),
    ],
    folder: Annotated[
        Path, typer.Option("--out", "-o", help="The data set, a new folder.", metavar="DIR")
    ] = Path("episodes"),
    to: Annotated[
        str, typer.Option(help="lerobot, or one registered.", metavar="FORMAT")
    ] = "lerobot",
    fps: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Frames per second; 50 if not given.",
            metavar="N",
        ),
    ] = None,
    video: Annotated[
        bool, typer.Option("--video", help="Film every episode (lerobot).", metavar="")
    ] = False,
    size: Annotated[
        str, typer.Option(help="Width and height of the films, pixels.", metavar="WxH")
    ] = "320x240",
    failed: Annotated[
        bool, typer.Option("--failed", help="Keep trials that failed, marked so.", metavar="")
    ] = False,
    most: Annotated[
        int | None,
        typer.Option("-n", "--number", min=1, help="Trials of every batch; all if not given."),
    ] = None,
    controller: Annotated[
        str,
        typer.Option(
            help="feedforward, impedance or policy:FILE; if not given, feedforward for grasps and "
            "impedance for turns.",
            metavar="NAME",
            rich_help_panel=TRIAL_PANEL,
        ),
    ] = "",
    sim_mu: SimMuOption = None,
    physics: PhysicsOption = "ours",
    as_json: JsonOption = False,
) -> None:
    """Trials as a LeRobot data set of episodes.

    Plans of grasps and manipulations and the rows of batches are executed in MuJoCo; reports with
    states are taken as they are. All are of one hand. Ctrl-C keeps the episodes that are whole; an
    error leaves nothing behind.
    """
    from sim.episodes import write_episodes
    from sim.episodes.episode import format_named
    from sim.episodes.film import check_films, size_of
    from sim.episodes.sources import Trials, sources_of
    from sim.episodes.writing import refuse_full
    from sim.learning import named_driver
    from sim.progress import ProgressBar

    format_named(to)  # bad input ends here
    driver = named_driver(controller)
    pixels = size_of(size)
    if video:
        check_films(pixels)
    refuse_full(folder)
    trials = Trials(controller=driver, physics=physics_of(physics, sim_mu), fps=fps)
    sources = sources_of(inputs, trials, most=most)
    with heeding_ctrl_c() as check, ProgressBar(err, ticks=True) as bar:

        def reports() -> Iterator[tuple[str, AnyReport]]:
            for done, source in enumerate(sources):
                bar.show("episodes", done, len(sources))
                check()
                yield source.name, source.report()

        def tell(episode: Episode, why: str) -> None:
            if why:
                say(err, escape(f"left out: {episode.source}: {why}"))

        written = write_episodes(
            reports(), folder, to, fps=fps, video=video, size=pixels, failed=failed, told=tell
        )
    if as_json:
        print_json(written.to_dict())
    else:
        say(out, escape(str(written)))
    if not written.complete:
        say(err, "interrupted; the episodes that were whole are kept")
        raise typer.Exit(EXIT_INTERRUPTED)
