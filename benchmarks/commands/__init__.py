"""Commands that measure: ``bench grasps``, ``synthesis``, ``control``, and others."""

from __future__ import annotations

import typer

from benchmarks.commands import (
    audit,
    best,
    control,
    dexgraspbench,
    episodes,
    exports,
    grasps,
    pages,
    reality,
    refine,
    synthesis,
    touch,
    turns,
    witness,
    zoo,
)

__all__ = ["register"]


def register(app: typer.Typer, panel: str) -> None:
    """Add the group ``bench`` to a panel of the help."""
    bench = typer.Typer(help="Tables that repeat the project's figures.", no_args_is_help=True)
    for command in (
        grasps.grasps,
        synthesis.synthesis,
        synthesis.objectives,
        best.best,
        refine.refine,
        grasps.walls,
        grasps.metrics,
        grasps.trials,
        audit.audit,
        synthesis.scaling,
        control.forces,
        control.control,
        turns.motion,
        turns.manipulate,
        reality.reality,
        control.physics,
        touch.touch,
        dexgraspbench.dexgraspbench,
        exports.exports,
        witness.witness,
        episodes.episodes,
        pages.pages,
        zoo.zoo,
        zoo.gallery,
    ):
        bench.command()(command)
    app.add_typer(bench, name="bench", rich_help_panel=panel)
