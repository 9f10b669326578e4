"""The command ``bench episodes``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from benchmarks.commands.common import BOTH_HANDS, BothHandsArgument, ObjectsOption, ResultOptions
from sim.cli.common import EXIT_NO, errors_for_people
from sim.cli.options import SeedOption, names, with_options


@errors_for_people()
@with_options
def episodes(
    hands: BothHandsArgument = None,
    lerobot: Annotated[
        Path, typer.Option(help="Python of an environment with LeRobot.", metavar="PYTHON")
    ] = Path("lerobot/bin/python"),
    objects: ObjectsOption = "sphere,box,cylinder",
    n: Annotated[
        int, typer.Option("-n", "--number", min=1, help="Grasps for each hand and object.")
    ] = 1,
    seed: SeedOption = 0,
    folder: Annotated[
        Path | None, typer.Option(help="Keep the data sets here; they are deleted otherwise.")
    ] = None,
    *,
    result: ResultOptions,
) -> None:
    """Have LeRobot itself read data sets of episodes, and compare them with their trials.

    Exit code 1 if anything that it reads is not what was recorded.
    """
    from benchmarks.episodes import agrees, episodes_table, run_episodes
    from planner.errors import NotFoundError

    if not lerobot.exists():
        raise NotFoundError(
            "Python",
            str(lerobot),
            (),
            "make an environment and install lerobot[dataset] into it, then give its Python",
            is_path=True,
        )
    with result.measuring() as runner:
        measured = run_episodes(
            hands or BOTH_HANDS,
            names(objects),
            n,
            python=lerobot.absolute(),
            folder=folder,
            seed=seed,
            runner=runner,
        )
    result.give(measured, episodes_table)
    if not agrees(measured):
        raise typer.Exit(EXIT_NO)
