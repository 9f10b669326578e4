"""``run_objectives``: what each objective of synthesis brings by every measure, and what it costs.

The same requests (hand, object, seed) are made with every objective alone and with none, so that
seeds are paired: their starts are the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from rich.table import Table

from benchmarks.objects import BenchObject
from benchmarks.requests import Setting, check_tasks, loaded_hand, task_for
from benchmarks.run import ObjectJob, measure
from benchmarks.statistics import median_of, ratio
from planner.batch.pool import grasp_seed
from planner.errors import PlannerError
from planner.plan_metrics import METRICS, evaluate_metrics
from planner.search import attempts
from planner.shapes import shape_key
from planner.synthesis.options import NO_OBJECTIVE, SynthesisOptions
from sim.runner import Check, Runner
from sim.tables import Row, grouped, number, percent, table_of

DIGITS = 3
"""Significant digits of a measure."""


@dataclass(frozen=True, kw_only=True)
class _Request(ObjectJob):
    """Request k of a hand and an object with an objective."""

    SHOWN: ClassVar = ("hand", "label", "objective", "k")

    objective: str
    k: int
    seed: int
    max_attempts: int

    def row(self, **values: Any) -> Row:
        """The row, with the name that the hand has in its file."""
        return super().row(**values) | {"hand": loaded_hand(self.hand).name}

    def lost(self, reason: str) -> Row:
        """The row of a request that could not be tried: nothing was found."""
        return self.row(attempts=0, cpu_s=0.0, measures=None, error=reason)


def run_objectives(
    hands: Sequence[str],
    objects: Sequence[BenchObject],
    n: int,
    *,
    objectives: Sequence[str],
    seed: int,
    max_attempts: int,
    runner: Runner,
) -> Row:
    """Make n requests of every hand and object with every objective (``benchmarks``)."""
    check_tasks(hands, objects)
    asked = [str(SynthesisOptions(objective=text).objective) for text in objectives]
    every = [(h, o, text, k) for h in hands for o in objects for text in asked for k in range(n)]
    jobs = [
        _Request(
            index=i,
            hand=hand,
            spec=item.spec,
            label=item.label,
            objective=text,
            k=k,
            seed=seed,
            max_attempts=max_attempts,
        )
        for i, (hand, item, text, k) in enumerate(every)
    ]
    result = measure(
        runner,
        _made,
        jobs,
        kind="opposable-bench-objectives",
        title="plan",
        lost=_Request.lost,
        version=2,
        seed=seed,
        max_attempts=max_attempts,
        units={name: metric.unit for name, metric in METRICS.items()},
    )
    return result | {"objectives": [summary_of_objective(text, result["rows"]) for text in asked]}


def _made(request: _Request, check: Check) -> Row:
    """Attempts until one is found, and the measures of what is found."""
    task = task_for(request.hand, request.spec, Setting())
    if isinstance(task, str):
        return request.lost(task)
    seed = grasp_seed(request.seed, shape_key(task.object.shape), request.k)
    options = SynthesisOptions(objective=request.objective)
    made, cpu, values = 0, 0.0, None
    try:
        for attempt in attempts(task, seed=seed, options=options):
            made += 1
            cpu += attempt.cpu_s
            check()
            if attempt.plan is not None:
                values = evaluate_metrics(attempt.plan)
            if values is not None or made >= request.max_attempts:
                break
    except PlannerError as error:
        return request.lost(str(error))
    return request.row(attempts=made, cpu_s=cpu, measures=values)


def summary_of_objective(objective: str, rows: Sequence[Row]) -> Row:
    """Cost and median measures of an objective, and how often each measure beat that of none.

    Args:
        objective: Which.
        rows: Requests with it, and those with none of the same hand, object and number.
    """
    mine = [row for row in rows if row["objective"] == objective]
    found = [row for row in mine if row["measures"] is not None]
    tried, cpu = sum(row["attempts"] for row in mine), sum(row["cpu_s"] for row in mine)
    plain = {_place(row): row["measures"] for row in rows if row["objective"] == NO_OBJECTIVE}
    pairs = [(r["measures"], theirs) for r in found if (theirs := plain.get(_place(r)))]
    cells = grouped(mine, "hand", "object").items()
    return {
        "objective": objective,
        "requested": len(mine),
        "found": len(found),
        "attempts": tried,
        "found_per_attempt": ratio(len(found), tried),
        "cpu_s_per_attempt": ratio(cpu, tried),
        "cpu_s_per_found": ratio(cpu, len(found)),
        "medians": _medians(mine),
        "better_than_none": {
            name: ratio(sum(ours[name] > theirs[name] for ours, theirs in pairs), len(pairs))
            for name in METRICS
        },
        "cells": [{"hand": h, "object": o, "medians": _medians(m)} for (h, o), m in cells],
    }


def _place(row: Row) -> tuple[str, str, int]:
    return row["hand"], row["object"], row["k"]


def _medians(rows: Sequence[Row]) -> dict[str, float | None]:
    """Of what was found."""
    found = [row["measures"] for row in rows if row["measures"] is not None]
    return {name: median_of(values[name] for values in found) for name in METRICS}


def objective_tables(result: Row) -> list[Table]:
    """One row per objective over everything; then each objective's own measure by cell."""
    units = [f"{name}" if u == "-" else f"{name} {u}" for name, u in result["units"].items()]
    whole = table_of(
        "medians over found grasps of all hands and objects; found per attempt; CPU ms per attempt "
        "and per found grasp",
        ("objective",),
        ("found", "attempt", "grasp", *units),
    )
    for each in result["objectives"]:
        whole.add_row(
            each["objective"],
            percent(each["found"], each["attempts"], 0),
            number(each["cpu_s_per_attempt"], 0, 1e3),
            number(each["cpu_s_per_found"], 0, 1e3),
            *(_digits(each["medians"][name]) for name in METRICS),
        )
    own = table_of(
        "its own measure: without objective, with it, and share of paired seeds that are better",
        ("objective", "hand", "object"),
        ("none", "with", "better"),
    )
    summaries = {each["objective"]: each for each in result["objectives"]}
    plain = summaries.pop(NO_OBJECTIVE, None)
    if plain is None:
        return [whole]
    # after Ctrl-C a cell may have no request without an objective
    before = {(c["hand"], c["object"]): c["medians"] for c in plain["cells"]}
    for name in (n for n in summaries if n in METRICS):
        each = summaries[name]
        for cell in each["cells"]:
            place = cell["hand"], cell["object"]
            old = before[place][name] if place in before else None
            own.add_row(name, *place, _digits(old), _digits(cell["medians"][name]), "")
        medians = (_digits(one["medians"][name]) for one in (plain, each))
        better = each["better_than_none"][name]
        own.add_row(name, "all", "", *medians, "-" if better is None else f"{100 * better:.0f} %")
        own.add_section()
    return [whole, own] if own.row_count else [whole]


def _digits(value: float | None) -> str:
    return "-" if value is None else np.format_float_positional(value, DIGITS, fractional=False)
