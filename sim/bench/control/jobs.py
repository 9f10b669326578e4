"""``run_control``: every part of the measurement for hands x objects, kept as it comes.

Grasp k of a part is that of cell k modulo their number, a cell being a hand and an object; all
parts see the same grasps. Rows have numbers that do not depend on how many are asked for, so that a
file can be gone on with for more grasps or other parts.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeAlias

import numpy as np

from planner.errors import NotFoundError, PlannerError
from planner.plan import GraspPlan
from planner.search import plan_grasp
from sim.bench.control.parts import drift_row, fc_row, robust_row
from sim.bench.control.promise import promise_row
from sim.bench.control.push import push_row
from sim.bench.control.rate import rate_row
from sim.bench.control.slip_trial import slip_row
from sim.bench.journal import run_with_journal
from sim.bench.objects import BenchObject
from sim.bench.requests import Setting, check_tasks, loaded_hand, task_for
from sim.runner import Check, Runner, made_with

__all__ = ["PARTS", "ControlJob", "Part", "control_jobs", "control_row", "grasps_of", "run_control"]

FORMAT = "opposable-bench-control"

Measure: TypeAlias = Callable[[GraspPlan, np.random.Generator], Mapping[str, Any]]


@dataclass(frozen=True, kw_only=True)
class Part:
    """One question that is asked of many grasps.

    Attributes:
        number: Its own, part of the numbers of its rows.
        measure: What is done with a grasp, and the directions it draws: plain data.
        grasps: How many grasps are asked by default.
        whole_hand: Whether all fingers of the hand must take part.
    """

    number: int
    measure: Measure
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
"""By name; more than these may come, and numbers stay."""

ROWS_PER_GRASP = 16
"""Numbers that a grasp has for its parts."""


@dataclass(frozen=True, kw_only=True)
class ControlJob:
    """One part for one grasp, as it is sent to a worker.

    Attributes:
        index: Its number.
        part: Name out of ``PARTS``.
        hand: Name or path.
        spec: The object.
        label: What it is called.
        grasp: Number of the grasp.
        plan_seed: Seed of planning.
        seed: Seed of the measurement, of what is drawn.
    """

    index: int
    part: str
    hand: str
    spec: str
    label: str
    grasp: int
    plan_seed: int
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
) -> list[ControlJob]:
    """The jobs, cell by cell, so that what a cell prepares serves all of its grasps.

    Args:
        hands: Names or paths.
        objects: The objects.
        parts: Name -> number of grasps.
        seed: Of the measurement.
    """
    cells = [(item, hand) for item in objects for hand in hands]
    jobs = [
        (
            (k % len(cells), k),
            ControlJob(
                index=ROWS_PER_GRASP * k + PARTS[part].number,
                part=part,
                hand=cells[k % len(cells)][1],
                spec=cells[k % len(cells)][0].spec,
                label=cells[k % len(cells)][0].label,
                grasp=k,
                plan_seed=seed + k // len(cells),
                seed=seed,
            ),
        )
        for part, n in parts.items()
        for k in range(n)
    ]
    return [job for _, job in sorted(jobs, key=lambda pair: pair[0])]


def control_row(job: ControlJob, check: Check) -> dict[str, Any]:
    """The row of a job, as plain data.

    Args:
        job: Which.
        check: Called before and after the trials; what it raises ends it.
    """
    part = PARTS[job.part]
    plan = _plan(job.hand, job.spec, job.plan_seed, part.whole_hand)
    check()
    if isinstance(plan, str):
        return _row(job, error=plan)
    rng = np.random.default_rng([job.seed, job.index])
    measured = part.measure(plan, rng)
    check()
    return _row(job, **measured)


def run_control(
    hands: Sequence[str],
    objects: Sequence[BenchObject],
    parts: Mapping[str, int],
    *,
    seed: int,
    file: Path,
    runner: Runner,
) -> dict[str, Any]:
    """Measure what the file does not have yet.

    Args:
        hands: Names or paths.
        objects: The objects.
        parts: Name -> number of grasps.
        seed: Of plans, directions and errors.
        file: Of the rows; made if it is not there.
        runner: Who works on them.

    Returns:
        Plain data: the rows that were asked for, and what they were made with.

    Raises:
        FileFormatError: The file is not one of these, or was begun with other arguments.
        PlannerError: A hand or an object that was named cannot be used.
    """
    check_tasks(hands, objects)
    jobs = control_jobs(hands, objects, parts, seed)
    asked = {
        "format": f"{FORMAT}-rows",
        "version": 1,
        "hands": list(hands),
        "objects": [item.spec for item in objects],
        "seed": seed,
    }
    rows, whole = run_with_journal(
        runner,
        control_row,
        jobs,
        file=file,
        asked=asked,
        title="control",
        given_up=lambda job, reason: _row(job, error=reason),
    )
    wanted = {job.index for job in jobs}
    return {
        "format": FORMAT,
        "version": 1,
        **made_with(),
        "workers": runner.workers,
        "interrupted": not whole,
        "parts": dict(parts),
        "rows": sorted((r for r in rows if r["index"] in wanted), key=lambda r: int(r["index"])),
    }


@lru_cache(maxsize=2)
def _plan(hand: str, spec: str, seed: int, whole_hand: bool) -> GraspPlan | str:
    """A plan, made once for the parts that follow each other; or why there is none."""
    fingers = tuple(loaded_hand(hand).fingers) if whole_hand else None
    task = task_for(hand, spec, Setting(fingers=fingers))
    if isinstance(task, str):
        return task
    try:
        return plan_grasp(task, seed=seed)
    except PlannerError as error:
        return str(error)


def _row(job: ControlJob, **values: Any) -> dict[str, Any]:
    return {
        "index": job.index,
        "part": job.part,
        "hand": job.hand,
        "object": job.label,
        "grasp": job.grasp,
        "error": "",
        **values,
    }
