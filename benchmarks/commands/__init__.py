"""Commands that measure, behind ``python -m benchmarks``: ``grasps``, ``control``, and others."""

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

__all__ = ["app"]


app = typer.Typer(
    help="Tables that repeat the project's figures.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)

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
    app.command()(command)
