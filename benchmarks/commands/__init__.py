"""Commands that measure, behind ``python -m benchmarks``: ``grasps``, ``control``, and others."""

from __future__ import annotations

import typer

from benchmarks.commands import turns
from benchmarks.commands.audit import audit
from benchmarks.commands.best import best
from benchmarks.commands.control import control
from benchmarks.commands.dexgraspbench import dexgraspbench
from benchmarks.commands.episodes import episodes
from benchmarks.commands.exports import exports
from benchmarks.commands.grasps import grasps
from benchmarks.commands.pages import pages
from benchmarks.commands.reality import reality
from benchmarks.commands.refine import refine
from benchmarks.commands.synthesis import synthesis
from benchmarks.commands.touch import touch
from benchmarks.commands.witness import witness
from benchmarks.commands.zoo import zoo

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
