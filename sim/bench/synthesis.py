"""``run_synthesis``: hands x objects x requests, and what they sum up to per hand and object."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from planner.batch import GraspFeatures, diversity
from planner.errors import ObjectError, TaskError
from planner.task import GraspTask
from sim.bench.baseline import against_baseline
from sim.bench.objects import BenchObject
from sim.bench.requests import APPROACH, Outcome, Request, Setting, loaded_hand, measure, task_for
from sim.bench.statistics import median_of, quantile_of, ratio, summed
from sim.runner import Check, Runner, made_with

__all__ = ["run_synthesis", "summary_of", "total_of"]

SOON = 1.0
"""CPU time (s) within which a request should be met."""

OTHER = "other"
"""What of an attempt is in no stage."""


@dataclass(frozen=True)
class _Cell:
    """One hand and object, and a number of a request of theirs."""

    number: int
    request: Request


def _measure(cell: _Cell, check: Check) -> tuple[int, Outcome]:
    return cell.number, measure(cell.request, check)


def _given_up(cell: _Cell, reason: str) -> tuple[int, Outcome]:
    return cell.number, Outcome(k=cell.request.k, reasons={reason: 1})


def run_synthesis(
    hands: Sequence[str],
    objects: Sequence[BenchObject],
    n: int,
    setting: Setting,
    *,
    runner: Runner,
    baseline: bool,
) -> dict[str, Any]:
    """Make n requests of every hand and object; Ctrl-C keeps what is finished.

    Args:
        hands: Names or paths.
        objects: The objects.
        n: Requests for each hand and object.
        setting: What all requests share.
        runner: Who works on them.
        baseline: Whether to compare with FRoGGeR's figures.

    Returns:
        Plain data: a summary and the requests of every cell, and what they were made with.

    Raises:
        PlannerError: A hand or an object that was named cannot be used; one out of a folder gets a
            row that says so.
    """
    for hand in hands:
        loaded_hand(hand).choose_fingers(setting.fingers)  # bad input ends here
    pairs = [(hand, item) for hand in hands for item in objects]
    jobs = [
        _Cell(number, Request(hand=hand, spec=item.spec, k=k, setting=setting))
        for number, (hand, item) in enumerate(pairs)
        for k in range(n)
    ]
    outcomes: list[list[Outcome]] = [[] for _ in pairs]

    def keep(result: tuple[int, Outcome]) -> None:
        number, outcome = result
        item = pairs[number][1]
        if outcome.error and not item.may_fail:
            raise ObjectError(outcome.error)
        outcomes[number].append(outcome)

    whole = made_with()
    finished = runner.run(_measure, jobs, title="plan", keep=keep, given_up=_given_up)
    cells = []
    for (hand, item), members in zip(pairs, outcomes, strict=True):
        if members:
            ordered = sorted(members, key=lambda o: o.k)
            task = task_for(hand, item.spec, setting)
            place = {"hand": loaded_hand(hand).name, "object": item.label}
            cells.append(place | summary_of(ordered, task))
    total = total_of(cells)
    return {
        "format": "opposable-bench-synthesis",
        "version": 1,
        **whole,
        "setting": asdict(setting),
        "workers": runner.workers,
        "interrupted": not finished,
        "total": total,
        "baseline": against_baseline(cells, total["found_per_cpu_s"]) if baseline else None,
        "cells": cells,
    }


def summary_of(outcomes: Sequence[Outcome], task: GraspTask | str) -> dict[str, Any]:
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
        "requested": len(outcomes),
        "found": len(found),
        "attempts": tried,
        "cpu_s": cpu,
        "prepare_cpu_s": sum(o.prepare_s for o in outcomes),
        "attempts_per_found": ratio(tried, len(found)),
        "found_per_cpu_s": ratio(len(found), cpu),
        "without_approach": passed,
        "found_per_cpu_s_without_approach": _without_approach(passed, stages, cpu),
        "within_1s": ratio(sum(o.found and o.cpu_s <= SOON for o in outcomes), len(outcomes)),
        "cpu_s_per_found": {
            "median": median_of(o.cpu_s for o in found),
            "p90": quantile_of((o.cpu_s for o in found), 0.9),
        },
        "stages_cpu_s": stages,
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


def _without_approach(passed: int | None, stages: Mapping[str, float], cpu: float) -> float | None:
    """Grasps per CPU second if none were asked for a way in; None where that is not known.

    That check is an attempt's last one and attempts are independent: without it those that only it
    refused would count, and its time would not.

    Args:
        passed: Attempts that passed everything else.
        stages: CPU time by stage, s.
        cpu: CPU time of all attempts, s.
    """
    if passed is None or APPROACH not in stages:
        return None
    return ratio(passed, cpu - stages[APPROACH])


def _with_fewer(found: Sequence[Outcome], task: GraspTask | str) -> int:
    """Grasps that spared a finger."""
    if isinstance(task, str):
        return 0
    return sum(o.n_fingers < len(task.finger_names) for o in found)


def _diversities(found: Sequence[Outcome], task: GraspTask | str) -> dict[str, Any]:
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


def total_of(cells: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Figures over all cells that could be tried."""
    tried = [c for c in cells if c["requested"]]
    found, requested = sum(c["found"] for c in tried), sum(c["requested"] for c in tried)
    cpu = sum(c["cpu_s"] for c in tried)
    stages = summed(c["stages_cpu_s"] for c in tried)
    taken = [r["cpu_s"] for c in tried for r in c["requests"] if r["found"]]
    counts = [c["without_approach"] for c in tried]
    all_known = None not in counts and all(APPROACH in c["stages_cpu_s"] for c in tried)
    return {
        "requested": requested,
        "found": found,
        "cpu_s": cpu,
        "prepare_cpu_s": sum(c["prepare_cpu_s"] for c in tried),
        "attempts_per_found": ratio(sum(c["attempts"] for c in tried), found),
        "found_per_cpu_s": ratio(found, cpu),
        "found_per_cpu_s_without_approach": _without_approach(
            sum(counts) if all_known else None, stages, cpu
        ),
        "within_1s": ratio(sum(t <= SOON for t in taken), requested),
        "within_1s_least": min((c["within_1s"] for c in tried), default=None),
        "cpu_s_per_found": {"median": median_of(taken), "p90": quantile_of(taken, 0.9)},
        "stages_cpu_s": stages,
    }
