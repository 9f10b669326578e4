"""``run_best``: the best grasp after so much CPU time, for several ways to search.

``rounds R`` are independent attempts with that many rounds, of which the best is kept; ``climb`` is
``keep="best"``, whose attempts build on each other. Request k of an object has one seed for all.
The CPU time of attempts counts; what comparing independent plans costs does not.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from rich.table import Table

from benchmarks.baseline import BASELINE_EPSILON
from benchmarks.objects import BenchObject
from benchmarks.requests import Setting, check_tasks, half_longest_side, task_for
from benchmarks.run import ObjectJob, measure
from benchmarks.statistics import median_of
from planner.batch.pool import grasp_seed
from planner.errors import NoGraspFoundError, PlannerError, TaskError
from planner.plan import GraspPlan
from planner.plan_metrics import Measure
from planner.quality.ball import epsilon_frogger
from planner.search import Attempt, plan_grasp
from planner.shapes import shape_key
from planner.synthesis.options import SynthesisOptions
from sim.runner import Check, Runner
from sim.tables import Row, grouped, number, table_of

CLIMB = "climb"
"""Name of the search whose attempts build on each other."""

WAYS = ("rounds 0", "rounds 4", "rounds 8", CLIMB)
"""The ways to search that are compared."""

REFERENCE = "rounds 4"
"""What the others are divided by: the default of independent attempts."""

MANY = 10**9
"""Grasps that no budget finds."""


@dataclass(frozen=True, kw_only=True)
class _Request(ObjectJob):
    """Request k of a hand and an object by a way to search."""

    SHOWN: ClassVar = ("hand", "label", "way", "k")

    way: str
    k: int
    metric: str
    marks: tuple[float, ...]
    setting: Setting

    def lost(self, reason: str) -> Row:
        """The row of a request that could not be tried."""
        return self.row(values=None, frogger=None, attempts=0, found=0, error=reason)


def run_best(
    hands: Sequence[str],
    objects: Sequence[BenchObject],
    n: int,
    *,
    marks: Sequence[float],
    metric: str,
    setting: Setting,
    runner: Runner,
    ways: Sequence[str] = WAYS,
) -> Row:
    """Make n requests of every hand and object in every way (``benchmarks``).

    Args:
        hands: See ``benchmarks``.
        objects: See ``benchmarks``.
        n: Requests.
        marks: CPU seconds after which the best is noted, ascending.
        metric: By what grasps are compared, and what attempts work on.
        setting: Friction, fingers and table; its rounds and attempts do not count.
        runner: See ``benchmarks``.
        ways: Some of ``WAYS``.

    Raises:
        TaskError: Marks that are not positive and ascending.
    """
    if not marks or marks[0] <= 0 or list(marks) != sorted(set(marks)):
        raise TaskError(f"marks are {list(marks)}; give CPU seconds > 0, ascending")
    metric = Measure.of(metric).text
    check_tasks(hands, objects)
    # ways take turns within a request: what slows the machine down meets all of them
    every = [(h, o, k, way) for h in hands for o in objects for k in range(n) for way in ways]
    jobs = [
        _Request(
            index=i,
            hand=hand,
            spec=item.spec,
            label=item.label,
            way=way,
            k=k,
            metric=metric,
            marks=tuple(marks),
            setting=setting,
        )
        for i, (hand, item, k, way) in enumerate(every)
    ]
    result = measure(
        runner,
        _made,
        jobs,
        kind="opposable-bench-best",
        title="search",
        lost=_Request.lost,
        metric=metric,
        marks=list(marks),
        n=n,
    )
    return result | {"ways": summary_of_ways(result["rows"])}


def _made(request: _Request, check: Check) -> Row:
    """The best value at every mark; of the plan at the last one also the baseline's epsilon."""
    task = task_for(request.hand, request.spec, request.setting)
    if isinstance(task, str):
        return request.lost(task)
    seed = grasp_seed(request.setting.seed, shape_key(task.object.shape), request.k)
    options = SynthesisOptions(objective=request.metric)
    how: dict[str, Any] = {"keep": "best", "options": options}
    if request.way != CLIMB:
        rounds = int(request.way.removeprefix("rounds "))
        how = {
            "best_of": MANY,
            "options": SynthesisOptions(objective=request.metric, rounds=rounds),
            "max_attempts": MANY,
        }
    curve: list[tuple[float, float | None]] = []
    made: list[Attempt[GraspPlan]] = []

    def note(attempt: Attempt[GraspPlan]) -> None:
        made.append(attempt)
        spent = attempt.cpu_s + (curve[-1][0] if curve else 0.0)
        curve.append((spent, attempt.best))
        check()

    plan = None
    try:
        with suppress(NoGraspFoundError):
            plan_grasp(task, seed=seed, max_attempts=1)  # prepares what all ways share
        with suppress(NoGraspFoundError):
            plan = plan_grasp(
                task,
                seed=seed,
                max_cpu_s=request.marks[-1],
                metric=request.metric,
                progress=note,
                **how,
            )
    except PlannerError as error:
        return request.lost(str(error))
    half = half_longest_side(task.object.shape)
    return request.row(
        values=[value_at(curve, mark) for mark in request.marks],
        frogger=None if plan is None else epsilon_frogger(plan.contacts, half_longest_side=half),
        attempts=len(made),
        found=sum(a.plan is not None for a in made),
        error="",
    )


def value_at(curve: Iterable[tuple[float, float | None]], mark: float) -> float | None:
    """The value that a curve of (CPU s, best so far) has at a mark; None for none yet."""
    return next((v for spent, v in reversed(list(curve)) if spent <= mark), None)


def summary_of_ways(rows: Sequence[Row]) -> list[Row]:
    """Medians per hand, object and way, and what they are over those of ``REFERENCE``.

    A request without a grasp counts as 0.
    """
    tried = [row for row in rows if row["values"] is not None]
    cells = [
        {
            "hand": hand,
            "object": item,
            "way": way,
            "medians": [
                median_of(v or 0.0 for v in column)
                for column in zip(*(r["values"] for r in mine), strict=True)
            ],
            "attempts": median_of(r["attempts"] for r in mine),
            "over_baseline": _over_baseline(item, mine),
        }
        for (hand, item, way), mine in grouped(tried, "hand", "object", "way").items()
    ]
    base = {(c["hand"], c["object"]): c["medians"] for c in cells if c["way"] == REFERENCE}
    for cell in cells:
        reference = base.get((cell["hand"], cell["object"]))
        cell["over_reference"] = reference and [
            mine / theirs if theirs else None
            for mine, theirs in zip(cell["medians"], reference, strict=True)
        ]
    return cells


def _over_baseline(item: str, rows: Sequence[Row]) -> float | None:
    """Median of the baseline's epsilon at the last mark over FRoGGeR's median on that object."""
    baseline = BASELINE_EPSILON.get(item)
    return baseline and (median_of(row["frogger"] or 0.0 for row in rows) or 0.0) / baseline


def best_tables(result: Row) -> list[Table]:
    """Medians by object and way; then each way over the reference."""
    marks = [f"{mark:g} s" for mark in result["marks"]]
    each = table_of(
        f"median of the best {result['metric']} of {result['n']} requests after CPU seconds; "
        "attempts made; FRoGGeR's epsilon at the end over its median",
        ("hand", "object", "search"),
        (*marks, "attempts", "over its"),
    )
    for cell in result["ways"]:
        each.add_row(
            cell["hand"],
            cell["object"],
            cell["way"],
            *(number(v, 3) for v in cell["medians"]),
            number(cell["attempts"], 0),
            number(cell["over_baseline"], 2),
        )
        if cell["way"] == result["ways"][-1]["way"]:
            each.add_section()
    whole = table_of(
        f"over {REFERENCE} after the same CPU seconds: median over objects (least)",
        ("search",),
        (*marks, "over its"),
    )
    for (way,), cells in grouped(result["ways"], "way").items():
        columns = zip(*(c["over_reference"] for c in cells if c["over_reference"]), strict=True)
        baseline = [c["over_baseline"] for c in cells]
        whole.add_row(way, *(_median_and_least(column) for column in (*columns, baseline)))
    return [each, whole]


def _median_and_least(values: Iterable[float | None]) -> str:
    known = [v for v in values if v is not None]
    return f"{np.median(known):.2f} ({min(known):.2f})" if known else "-"
