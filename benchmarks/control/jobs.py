"""``run_control``: all parts of the measurement for hands x objects.

A cell is a hand and an object. Grasp k belongs to cell k modulo the number of cells; all parts use
the same grasps. The number of a row depends on grasp and part alone: a file can be continued with
more grasps or other parts.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np

from benchmarks.control.parts import drift_row, fc_row, rate_row, robust_row
from benchmarks.control.promise import promise_row
from benchmarks.control.push import push_row
from benchmarks.control.slip_trial import slip_row
from benchmarks.objects import BenchObject
from benchmarks.planned import PlannedJob, ask, run_parts
from benchmarks.run import stated
from planner.errors import NotFoundError
from planner.plan import GraspPlan
from sim.reality import Reality
from sim.runner import Check, Runner
from sim.tables import Row


@dataclass(frozen=True, kw_only=True)
class Part:
    """One question that is asked of many grasps.

    Attributes:
        number: Its place among the row numbers of a grasp.
        measure: Measures a grasp under a reality; draws directions from the generator; gives plain
            data.
        grasps: How many grasps are asked by default.
        whole_hand: Whether all fingers of the hand must take part.
    """

    number: int
    measure: Callable[[GraspPlan, np.random.Generator, Reality], Mapping[str, Any]]
    grasps: int
    whole_hand: bool = False


PARTS: Mapping[str, Part] = MappingProxyType(
    {
        "fc": Part(number=0, measure=fc_row, grasps=200),
        "push": Part(number=1, measure=push_row, grasps=50),
        "drift": Part(number=2, measure=drift_row, grasps=20),
        "slip": Part(number=3, measure=slip_row, grasps=20),
        "robust": Part(number=4, measure=robust_row, grasps=60),
        "rate": Part(number=5, measure=rate_row, grasps=4, whole_hand=True),
        "promise": Part(number=6, measure=promise_row, grasps=20),
    }
)
"""By name. A new part takes a new number."""

ROWS_PER_GRASP = 16
"""Row numbers reserved for each grasp."""


@dataclass(frozen=True, kw_only=True)
class ControlJob(PlannedJob):
    """One part for one grasp.

    Attributes:
        grasp: Number of the grasp.
        seed: Seed of the measurement, of what is drawn.
    """

    SHOWN: ClassVar = ("part", "hand", "label", "grasp")

    grasp: int
    seed: int


def grasps_of(names: Iterable[str], n: int | None) -> dict[str, int]:
    """Name of each part -> number of grasps: n, or its own where that is None.

    Raises:
        NotFoundError: There is no such part.
    """
    asked = {}
    for name in names:
        if name not in PARTS:
            raise NotFoundError("part", name, PARTS)
        asked[name] = PARTS[name].grasps if n is None else n
    return asked


def control_jobs(
    hands: Sequence[str],
    objects: Sequence[BenchObject],
    parts: Mapping[str, int],
    seed: int,
    reality: Reality | None = None,
) -> list[ControlJob]:
    """The jobs, cell by cell, so that what a cell prepares serves all of its grasps."""
    cells = [(item, hand) for item in objects for hand in hands]
    reality = reality or Reality()
    jobs = []
    for part, n in parts.items():
        for k in range(n):
            item, hand = cells[k % len(cells)]
            job = ControlJob(
                index=ROWS_PER_GRASP * k + PARTS[part].number,
                part=part,
                hand=hand,
                spec=item.spec,
                label=item.label,
                grasp=k,
                reality=reality.seeded(k),
                plan_seed=seed + k // len(cells),
                seed=seed,
            )
            jobs.append(job)
    return sorted(jobs, key=lambda job: (job.grasp % len(cells), job.grasp))


def control_row(job: ControlJob, check: Check) -> Row:
    """The row of a job; the arguments are those of ``ask``."""
    part = PARTS[job.part]
    rng = np.random.default_rng([job.seed, job.index])
    return ask(
        job, check, lambda plan: part.measure(plan, rng, job.reality), whole_hand=part.whole_hand
    )


def run_control(
    hands: Sequence[str],
    objects: Sequence[BenchObject],
    parts: Mapping[str, int],
    *,
    seed: int,
    file: Path,
    runner: Runner,
    reality: Reality | None = None,
) -> Row:
    """Measure parts, name -> number of grasps; one seed for plans and draws (``benchmarks``).

    Errors of a reality are drawn from the number of the grasp.
    """
    reality = reality or Reality()
    return run_parts(
        runner,
        control_row,
        control_jobs(hands, objects, parts, seed, reality),
        hands,
        objects,
        kind="opposable-bench-control",
        title="control",
        file=file,
        drawn={"seed": seed, **stated(reality)},
        parts=dict(parts),
        **stated(reality),
    )
