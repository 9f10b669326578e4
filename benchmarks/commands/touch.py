"""``bench touch``: what senses of touch know, beside the truth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from benchmarks.commands.common import (
    BOTH_HANDS,
    BothHandsArgument,
    NumberOption,
    ResultOptions,
    SamplesOption,
)
from sim.cli.common import errors_for_people
from sim.cli.options import SeedOption, names, with_options


@errors_for_people()
@with_options
def touch(
    hands: BothHandsArgument = None,
    n: NumberOption = 10,
    parts: Annotated[
        str, typer.Option(help="Comma separated: arrays, engines, turns, slips.")
    ] = "arrays,engines,turns,slips",
    seed: SeedOption = 0,
    samples: SamplesOption = Path("touch.jsonl"),
    *,
    result: ResultOptions,
) -> None:
    """Measure touch: contacts and slips from taxels, motor effort and binary contact.

    Both right hands of the project unless others are named. arrays: random contacts on arrays of
    several spacings and noises. engines: MuJoCo's own tactile sensors on a pad that is pressed.
    turns: senses watch objects that are turned by 90 degrees. slips: pushes until pads slip.
    """
    from benchmarks.touch import run_touch, touch_tables

    with result.measuring(samples) as runner:
        measured = run_touch(
            hands or BOTH_HANDS, names(parts), n, seed=seed, file=samples, runner=runner
        )
    result.give(measured, touch_tables)
