"""``run_objectives``: what each objective of synthesis brings by every measure, and what it costs.

The same requests (hand, object, seed) are made with every objective alone and with none, so that
seeds are paired: their starts are the same.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from rich.table import Table

from planner.batch.jobs import grasp_seed
from planner.batch.recipe import shape_key
from planner.errors import PlannerError
from planner.plan_metrics import METRICS, evaluate_metrics
from planner.search import attempts
from planner.synthesis.options import NO_OBJECTIVE, SynthesisOptions
from sim.bench.objects import BenchObject
from sim.bench.requests import Setting, check_tasks, loaded_hand, task_for
from sim.bench.statistics import median_of, ratio
from sim.bench.tables import number, table_of
from sim.runner import Runner, made_with

__all__ = ["objective_tables", "run_objectives", "summary_of_objective"]

SETTING = Setting()
"""Tasks and budgets are those of ``bench synthesis``."""

DIGITS = 3
"""Significant digits of a measure."""


@dataclass(frozen=True, kw_only=True)
class _Request:
    """Request k of a hand and an object with an objective."""

    hand: str
    item: BenchObject
    objective: str
    k: int
    seed: int
    max_attempts: int


def run_objectives(
    hands: Sequence[str],
    objects: Sequence[BenchObject],
    n: int,
    *,
    objectives: Sequence[str],
    seed: int,
    max_attempts: int,
    runner: Runner,
) -> dict[str, Any]:
    """Make n requests of every hand and object with every objective; Ctrl-C keeps what is done.

    Args:
        hands: Names or paths.
        objects: The objects.
        n: Requests for each hand, object and objective.
        objectives: Texts of ``SynthesisOptions.objective``.
        seed: Same seed, same requests.
        max_attempts: Attempts of a request.
        runner: Who works on them.

    Raises:
        PlannerError: A hand, an object that was named, or an objective cannot be used; an object
            out of a folder may fail.
    """
    check_tasks(hands, objects)
    asked = [str(SynthesisOptions(objective=text).objective) for text in objectives]
    requests = [
        _Request(hand=hand, item=item, objective=text, k=k, seed=seed, max_attempts=max_attempts)
        for hand in hands
        for item in objects
        for text in asked
        for k in range(n)
    ]
    rows: list[dict[str, Any]] = []
    whole = made_with()
    finished = runner.run(_measure, requests, title="plan", keep=rows.append, given_up=_given_up)
    rows.sort(key=lambda row: (row["hand"], row["object"], asked.index(row["objective"]), row["k"]))
    return {
        "format": "opposable-bench-objectives",
        "version": 1,
        **whole,
        "seed": seed,
        "max_attempts": max_attempts,
        "workers": runner.workers,
        "interrupted": not finished,
        "units": {name: metric.unit for name, metric in METRICS.items()},
        "objectives": [summary_of_objective(text, rows) for text in asked],
        "rows": rows,
    }


def _measure(request: _Request, check: Callable[[], None]) -> dict[str, Any]:
    """Attempts until one is found, and the measures of what is found."""
    task = task_for(request.hand, request.item.spec, SETTING)
    if isinstance(task, str):
        return _given_up(request, task)
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
        return _given_up(request, str(error))
    return {
        "hand": task.hand.name,
        "object": request.item.label,
        "objective": request.objective,
        "k": request.k,
        "attempts": made,
        "cpu_s": cpu,
        "measures": values,
    }


def _given_up(request: _Request, reason: str) -> dict[str, Any]:
    """The row of a request that could not be tried or killed its processes: nothing was found."""
    return {
        "hand": loaded_hand(request.hand).name,
        "object": request.item.label,
        "objective": request.objective,
        "k": request.k,
        "attempts": 0,
        "cpu_s": 0.0,
        "measures": None,
        "error": reason,
    }


def summary_of_objective(objective: str, rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Cost and median measures of an objective, and how often each measure beat that of none.

    Args:
        objective: Which.
        rows: Requests with it, and those with none of the same hand, object and number.
    """
    mine = [row for row in rows if row["objective"] == objective]
    found = [row for row in mine if row["measures"] is not None]
    tried, cpu = sum(row["attempts"] for row in mine), sum(row["cpu_s"] for row in mine)
    plain = {_place(row): row["measures"] for row in rows if row["objective"] == NO_OBJECTIVE}
    pairs = [(row["measures"], plain.get(_place(row))) for row in found]
    cells = list(dict.fromkeys((row["hand"], row["object"]) for row in mine))
    return {
        "objective": objective,
        "requested": len(mine),
        "found": len(found),
        "attempts": tried,
        "found_per_attempt": ratio(len(found), tried),
        "cpu_s_per_attempt": ratio(cpu, tried),
        "cpu_s_per_found": ratio(cpu, len(found)),
        "medians": _medians(found),
        "better_than_none": {
            name: ratio(
                sum(ours[name] > theirs[name] for ours, theirs in pairs if theirs is not None),
                sum(theirs is not None for _, theirs in pairs),
            )
            for name in METRICS
        },
        "cells": [
            {
                "hand": hand,
                "object": item,
                "medians": _medians([r for r in found if (r["hand"], r["object"]) == (hand, item)]),
            }
            for hand, item in cells
        ],
    }


def _place(row: dict[str, Any]) -> tuple[str, str, int]:
    return row["hand"], row["object"], row["k"]


def _medians(found: Sequence[dict[str, Any]]) -> dict[str, float | None]:
    return {name: median_of(row["measures"][name] for row in found) for name in METRICS}


def objective_tables(result: dict[str, Any]) -> list[Table]:
    """One row per objective over everything; then each objective's own measure by cell."""
    names = tuple(METRICS)
    units = [f"{name}" if u == "-" else f"{name} {u}" for name, u in result["units"].items()]
    whole = table_of(
        "medians over found grasps of all hands and objects; found per attempt; CPU ms per attempt "
        "and per found grasp",
        ("objective",),
        ("found", "attempt", "grasp", *units),
    )
    for each in result["objectives"]:
        share = each["found_per_attempt"]
        whole.add_row(
            each["objective"],
            "-" if share is None else f"{100 * share:.0f} %",
            number(each["cpu_s_per_attempt"], 0, 1e3),
            number(each["cpu_s_per_found"], 0, 1e3),
            *(_digits(each["medians"][name]) for name in names),
        )
    own = table_of(
        "its own measure: without objective, with it, and share of paired seeds that are better",
        ("objective", "hand", "object"),
        ("none", "with", "better"),
    )
    plain = next((e for e in result["objectives"] if e["objective"] == NO_OBJECTIVE), None)
    for each in result["objectives"] if plain is not None else ():
        name = each["objective"]
        if name not in names or plain is None:
            continue
        before = {(c["hand"], c["object"]): c["medians"][name] for c in plain["cells"]}
        for cell in each["cells"]:
            place = cell["hand"], cell["object"]
            # after Ctrl-C a cell may have no request without an objective
            medians = (_digits(before.get(place)), _digits(cell["medians"][name]))
            own.add_row(name, *place, *medians, "")
        better = each["better_than_none"][name]
        own.add_row(
            name,
            "all",
            "",
            _digits(plain["medians"][name]),
            _digits(each["medians"][name]),
            "-" if better is None else f"{100 * better:.0f} %",
        )
        own.add_section()
    return [whole, own] if own.row_count else [whole]


def _digits(value: float | None) -> str:
    return (
        "-" if value is None else f"{np.format_float_positional(value, DIGITS, fractional=False)}"
    )
