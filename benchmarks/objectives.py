"""Measure what each objective of synthesis brings, and what it costs.

The same requests (hand, object, seed) are made with every objective alone and with none, so that
seeds are paired: their starts are the same.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import typer

from benchmarks.bench import HandOptions, NumberOption, ObjectsOption
from benchmarks.common import cells_of, seed_of, task_of
from benchmarks.summary import Cell, Frame, amount, of, ratio, summary
from planner.search.grasp import attempts
from planner.search.metrics import METRICS, evaluate_metrics
from planner.synthesis import OBJECTIVES
from planner.synthesis.options import NO_OBJECTIVE, SynthesisOptions
from sim.cli.options import AttemptsOption, names
from sim.tables import Row

DIGITS = 3
"""Significant digits of a measure."""


@dataclass(frozen=True, kw_only=True)
class Options(HandOptions):
    """Requests of every hand and object with every objective."""

    n: NumberOption = 15
    objects: ObjectsOption = "cylinder,box,mug"
    objectives: Annotated[
        str,
        typer.Option(
            help="Objectives, comma separated; of several with weights: a:1+b:0.5; all stands for "
            "none and each alone."
        ),
    ] = "all"
    max_attempts: AttemptsOption = 50


def cases(options: Options) -> Iterator[Row]:
    """Requests of every hand, object and objective."""
    every = [NO_OBJECTIVE, *OBJECTIVES]
    asked = every if options.objectives == "all" else names(options.objectives)
    texts = [SynthesisOptions(objective=text.replace("+", ",")).objective for text in asked]
    given = {"seed": options.seed, "max_attempts": options.max_attempts}
    for cell in cells_of(options.hand_names, options.objects):
        for text in texts:
            for k in range(options.n):
                yield {**cell, "objective": str(text), "k": k, **given}


def measure(case: Row) -> Row:
    """Attempts until one is found, and the measures of what is found."""
    task = task_of(case["hand"], case["spec"])
    seed = seed_of(case["seed"], task.object.shape, case["k"])
    options = SynthesisOptions(objective=case["objective"])
    made, cpu, values = 0, 0.0, None
    for attempt in attempts(task, seed=seed, options=options):
        made += 1
        cpu += attempt.cpu_s
        if attempt.plan is not None:
            values = evaluate_metrics(attempt.plan)
        if values is not None or made >= case["max_attempts"]:
            break
    return {"attempts": made, "cpu_s": cpu, "found": int(values is not None), "measures": values}


def tables(result: Row) -> Iterator[Row]:
    """One row per objective over everything; then each objective's own measure by cell."""
    rows = [{**row, **(row.get("measures") or {})} for row in result["rows"] if not row["error"]]
    yield summary(
        "medians over found grasps of all hands and objects; found per attempt; CPU ms per attempt "
        "and per found grasp",
        rows,
        ("objective",),
        {
            "found %": ratio("found", "attempts", 0, 100.0),
            "attempt": ratio("cpu_s", "attempts", 0, 1e3),
            "grasp": ratio("cpu_s", "found", 0, 1e3),
            **{
                name if metric.unit == "-" else f"{name} {metric.unit}": _digits(name)
                for name, metric in METRICS.items()
            },
        },
    )
    plain = {(r["hand"], r["object"], r["k"]): r for r in rows if r["objective"] == NO_OBJECTIVE}
    pairs = []
    for row in rows:
        name = row["objective"]
        before = plain.get((row["hand"], row["object"], row["k"]))
        if name in METRICS and before is not None:
            with_, without = (r.get(name) for r in (row, before))
            better = None
            if with_ is not None and without is not None:
                better = 100.0 * (with_ > without)
            pairs.append({**row, "without": without, "with": with_, "better": better})
    yield summary(
        "its own measure: without objective, with it, and % of paired seeds that are better",
        pairs,
        ("objective", "hand", "object"),
        {"none": _digits("without"), "with": _digits("with"), "better %": of("better", "mean", 0)},
        [(None, "all", "")],
    )


def _digits(name: str) -> Cell:
    def cell(frame: Frame) -> str:
        value = amount(frame, name)
        if value is None:
            return "-"
        return np.format_float_positional(value, DIGITS, fractional=False)

    return cell
