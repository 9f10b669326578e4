"""``run_synthesis``: hands x objects x requests, and what they sum up to per hand and object."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, ClassVar

import numpy as np

from benchmarks.baseline import against_baseline
from benchmarks.first_grasp import first_grasp_s
from benchmarks.objects import BenchObject
from benchmarks.requests import (
    APPROACH,
    Request,
    RequestOutcome,
    Setting,
    loaded_hand,
    outcome_of,
    task_for,
)
from benchmarks.run import Job, measure
from benchmarks.statistics import median_of, quantile_of, ratio, summed
from planner.batch import GraspFeatures, diversity
from planner.errors import ObjectError, TaskError
from planner.task import GraspTask
from sim.runner import Check, Runner
from sim.tables import Row, grouped

SOON = 1.0
"""CPU time (s) within which a request should be met."""

OTHER = "other"
"""What of an attempt is in no stage."""


@dataclass(frozen=True, kw_only=True)
class _RequestJob(Job):
    """A request, the number of its hand and object, and whether to time it from nothing too."""

    SHOWN: ClassVar = ("cell",)

    cell: int
    request: Request
    first: bool

    def lost(self, reason: str) -> Row:
        """The row of a request that killed its processes."""
        return self.row(outcome=RequestOutcome(k=self.request.k, reasons={reason: 1}))


def _made(job: _RequestJob, check: Check) -> Row:
    outcome = outcome_of(job.request, check)
    if job.first and not outcome.error:
        outcome = replace(outcome, first_s=first_grasp_s(job.request))
    return job.row(outcome=outcome)


def run_synthesis(
    hands: Sequence[str],
    objects: Sequence[BenchObject],
    n: int,
    setting: Setting,
    *,
    runner: Runner,
    baseline: bool,
    first: bool = False,
) -> Row:
    """Make n requests of every hand and object, and sum them up (``benchmarks``).

    Args:
        hands: Names or paths.
        objects: Objects.
        n: Requests of each hand and object.
        setting: What they share.
        runner: What runs them.
        baseline: Whether to compare with FRoGGeR.
        first: Whether to time the first request of each from nothing too, in a process of its own.
    """
    for hand in hands:
        loaded_hand(hand).choose_fingers(setting.fingers)  # bad input ends here
    pairs = [(hand, item) for hand in hands for item in objects]
    every = [
        (number, Request(hand=hand, spec=item.spec, k=k, setting=setting))
        for number, (hand, item) in enumerate(pairs)
        for k in range(n)
    ]

    def refuse(row: Row) -> None:
        if row["outcome"].error and not pairs[row["cell"]][1].may_fail:
            raise ObjectError(row["outcome"].error)

    result = measure(
        runner,
        _made,
        [
            _RequestJob(index=i, cell=number, request=r, first=first and r.k == 0)
            for i, (number, r) in enumerate(every)
        ],
        kind="opposable-bench-synthesis",
        title="plan",
        lost=_RequestJob.lost,
        seen=refuse,
        setting=asdict(setting),
    )
    cells = []
    for (number,), rows in grouped(result.pop("rows"), "cell").items():
        hand, item = pairs[number]
        summary = summary_of([r["outcome"] for r in rows], task_for(hand, item.spec, setting))
        cells.append({"hand": loaded_hand(hand).name, "object": item.label, **summary})
    total = total_of(cells)
    against = against_baseline(cells, total["found_per_cpu_s"]) if baseline else None
    return result | {"total": total, "baseline": against, "cells": cells}


def summary_of(outcomes: Sequence[RequestOutcome], task: GraspTask | str) -> Row:
    """Figures of the requests of one hand and object as plain data, and the requests.

    Args:
        outcomes: At least one.
        task: Their task, for the diversity; or why there is none.
    """
    error = next((o.error for o in outcomes if o.error), "")
    outcomes = [o for o in outcomes if not o.error]
    found = [o for o in outcomes if o.found]
    cpu = sum(o.cpu_s for o in outcomes)
    named = summed(o.stages for o in outcomes)
    stages = summed([named, {OTHER: max(0.0, cpu - sum(named.values()))}])
    tried = sum(o.attempts for o in outcomes)
    known = [o.without_approach for o in outcomes if o.without_approach is not None]
    passed = sum(known) if len(known) == len(outcomes) else None
    return {
        "error": error,
        "attempts": tried,
        "without_approach": passed,
        **_figures(
            [o.cpu_s for o in found], len(outcomes), tried, cpu, stages=stages, passed=passed
        ),
        "prepare_cpu_s": sum(o.prepare_s for o in outcomes),
        "first_grasp_cpu_s": median_of([o.first_s for o in outcomes if o.first_s is not None]),
        "epsilon": _low(o.epsilon for o in found),
        "epsilon_frogger": _low(o.epsilon_frogger for o in found),
        "clearance_mm": _low(o.clearance_mm for o in found),
        "with_fewer_fingers": _with_fewer(found, task),
        "reasons": summed(o.reasons for o in outcomes),
        **_diversities(found, task),
        "requests": [asdict(replace(o, features=None)) for o in outcomes],
    }


def _low(values: Iterable[float | None]) -> dict[str, float | None]:
    """Median and lowest tenth of what should be large."""
    known = [v for v in values if v is not None]
    return {"median": median_of(known), "p10": quantile_of(known, 0.1)}


def _figures(
    taken: Sequence[float],
    requested: int,
    attempts: int,
    cpu: float,
    *,
    stages: Mapping[str, float],
    passed: int | None,
) -> Row:
    """Counts and speeds of requests.

    "without approach" are grasps per CPU second if none were asked for a way in; None where that is
    not known. That check is an attempt's last one and attempts are independent: without it those
    that only it refused would count, and its time would not.

    Args:
        taken: CPU time of each request that found a grasp, s.
        requested: How many requests there were.
        attempts: How many attempts they made.
        cpu: CPU time of these, s.
        stages: The same by stage.
        passed: Attempts that passed everything but the way in, if that is known.
    """
    known = passed is not None and APPROACH in stages
    alone = ratio(passed or 0, cpu - stages[APPROACH]) if known else None
    return {
        "requested": requested,
        "found": len(taken),
        "cpu_s": cpu,
        "attempts_per_found": ratio(attempts, len(taken)),
        "found_per_cpu_s": ratio(len(taken), cpu),
        "found_per_cpu_s_without_approach": alone,
        "within_1s": ratio(sum(t <= SOON for t in taken), requested),
        "cpu_s_per_found": {"median": median_of(taken), "p90": quantile_of(taken, 0.9)},
        "stages_cpu_s": dict(stages),
    }


def _with_fewer(found: Sequence[RequestOutcome], task: GraspTask | str) -> int:
    """Grasps that spared a finger."""
    if isinstance(task, str):
        return 0
    return sum(o.n_fingers < len(task.finger_names) for o in found)


def _diversities(found: Sequence[RequestOutcome], task: GraspTask | str) -> Row:
    """Diversity of the grasps with all fingers, and of as many random starts; None for none."""
    nothing = {"diversity": None, "diversity_of_random_starts": None}
    if isinstance(task, str):
        return nothing
    kept = [
        o.features
        for o in found
        if o.features is not None and o.n_fingers == len(task.finger_names)
    ]
    if not kept:
        return nothing
    names = GraspFeatures.__dataclass_fields__
    grasps = GraspFeatures(**{k: np.concatenate([getattr(f, k) for f in kept]) for k in names})
    try:
        starts = GraspFeatures.of_random_starts(task, len(grasps))
    except TaskError:
        return nothing
    shape = task.object.shape
    return {
        "diversity": diversity(grasps, shape).to_dict(),
        "diversity_of_random_starts": diversity(starts, shape).to_dict(),
    }


def total_of(cells: Sequence[Row]) -> Row:
    """Figures over all cells that could be tried."""
    tried = [c for c in cells if c["requested"]]
    taken = [r["cpu_s"] for c in tried for r in c["requests"] if r["found"]]
    counts = [c["without_approach"] for c in tried]
    firsts = [c["first_grasp_cpu_s"] for c in tried if c["first_grasp_cpu_s"] is not None]
    all_known = None not in counts and all(APPROACH in c["stages_cpu_s"] for c in tried)

    def added(name: str) -> Any:
        return sum(c[name] for c in tried)

    return {
        **_figures(
            taken,
            added("requested"),
            added("attempts"),
            added("cpu_s"),
            stages=summed(c["stages_cpu_s"] for c in tried),
            passed=sum(counts) if all_known else None,
        ),
        "prepare_cpu_s": added("prepare_cpu_s"),
        "first_grasp_cpu_s": median_of(firsts),
        "first_grasp_cpu_s_worst": max(firsts, default=None),
        "within_1s_least": min((c["within_1s"] for c in tried), default=None),
    }
