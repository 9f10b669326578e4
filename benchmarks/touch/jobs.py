"""``run_touch``: all parts of the measurement of touch.

The number of a row follows from part, hand, object and trial alone, so that a file goes on with
more trials or other parts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar

from benchmarks.run import ObjectJob, measure
from benchmarks.touch.arrays import array_row
from benchmarks.touch.engines import engines_row
from benchmarks.touch.trials import slip_trial, turn_trial
from planner.errors import NotFoundError
from sim.runner import Check, Runner
from sim.tables import Row

PARTS: Mapping[str, int] = MappingProxyType({"arrays": 0, "engines": 1, "turns": 2, "slips": 3})
"""Parts, and their place among the numbers of a trial."""

TURNED = ("cylinder:0.03x0.08", "box:0.05x0.05x0.1")
"""Objects that are turned."""

PUSHED = ("box", "cylinder", "sphere")
"""Objects that are pushed until they slip."""

TRIALS, CELLS = 1000, 10
"""Most trials of a cell; numbers reserved for its cells."""


@dataclass(frozen=True, kw_only=True)
class TouchJob(ObjectJob):
    """One trial of one part.

    Attributes:
        SHOWN: See ``Job``.
        part: Its name.
        seed: Of the trial.
    """

    SHOWN: ClassVar = ("part", "hand", "label", "seed")

    part: str
    seed: int


def touch_jobs(hands: Sequence[str], parts: Sequence[str], n: int, seed: int) -> list[TouchJob]:
    """The jobs.

    Args:
        hands: Names or paths.
        parts: Out of ``PARTS``.
        n: Trials of each hand and object.
        seed: Of the first trial.
    """
    jobs = []
    for part in parts:
        objects = {"turns": TURNED, "slips": PUSHED}.get(part, ("",))
        of_hands = [""] if part == "engines" else hands
        for i, hand in enumerate(of_hands):
            for j, spec in enumerate(objects):
                for k in range(n if spec else 1):
                    cell = (PARTS[part] * CELLS + i) * CELLS + j
                    jobs.append(
                        TouchJob(
                            index=cell * TRIALS + k,
                            part=part,
                            hand=hand,
                            spec=spec,
                            label=spec,
                            seed=seed + k,
                        )
                    )
    return jobs


def touch_row(job: TouchJob, check: Check) -> Row:
    """The row of a job."""
    check()
    made: dict[str, Any]
    if job.part == "arrays":
        made = {"error": "", **array_row(job.hand, job.seed)}
    elif job.part == "engines":
        made = {"error": "", **engines_row(job.seed)}
    elif job.part == "turns":
        made = turn_trial(job.hand, job.spec, job.seed)
    else:
        made = slip_trial(job.hand, job.spec, job.seed)
    check()
    return job.row(**made)


def run_touch(
    hands: Sequence[str],
    parts: Sequence[str],
    n: int,
    *,
    seed: int,
    file: Path,
    runner: Runner,
) -> Row:
    """Measure parts; what the file has already is not measured again.

    Args:
        hands: Names or paths.
        parts: Out of ``PARTS``.
        n: Trials of each hand and object in ``turns`` and ``slips``.
        seed: Of the first trial.
        file: Of the rows; made if it is not there.
        runner: Who works.

    Raises:
        NotFoundError: A part that there is not.
        FileFormatError: The file is another one, or was begun with other arguments.
    """
    for part in parts:
        if part not in PARTS:
            raise NotFoundError("part", part, PARTS)
    kind = "opposable-bench-touch"
    return measure(
        runner,
        touch_row,
        touch_jobs(hands, parts, n, seed),
        kind=kind,
        title="touch",
        lost=TouchJob.lost,
        file=file,
        asked={"format": f"{kind}-rows", "version": 1, "hands": list(hands), "seed": seed},
        parts=list(parts),
    )
