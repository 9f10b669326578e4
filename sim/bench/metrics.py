"""``run_metrics``: which metric predicts what happens in simulation.

Samples (``sim.bench.trials``) are kept as they come (``sim.bench.journal``).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from planner.spatial import FloatArray
from sim.bench.auc import Auc, auc
from sim.bench.journal import run_with_journal
from sim.bench.objects import BenchObject
from sim.bench.predictors import PREDICTORS
from sim.bench.requests import check_tasks
from sim.bench.tables import table_of
from sim.bench.trials import CONDITIONS, GRADES, Sample, lost_sample, try_sample
from sim.runner import Runner, made_with

__all__ = ["metrics_table", "run_metrics", "samples_for", "summary_of_trials"]

FORMAT = "opposable-bench-metrics"
SAME = "same task"
"""Column of pairs of the same hand, object and condition: which of two grasps of this object?"""


def samples_for(
    hands: Sequence[str], objects: Sequence[BenchObject], n: int, seed: int
) -> list[Sample]:
    """N samples: cell after cell, in each of them conditions and grades equally often."""
    cells = [(hand, item) for hand in hands for item in objects]
    each = -(-n // len(cells))
    grades, conditions = list(GRADES), list(CONDITIONS)
    samples = []
    for index in range(n):
        hand, item = cells[index // each]
        turn, condition = divmod(index % each, len(conditions))
        samples.append(
            Sample(
                index=index,
                hand=hand,
                spec=item.spec,
                label=item.label,
                grade=grades[turn % len(grades)],
                condition=conditions[condition],
                seed=seed,
            )
        )
    return samples


def run_metrics(
    hands: Sequence[str],
    objects: Sequence[BenchObject],
    n: int,
    *,
    seed: int,
    file: Path,
    runner: Runner,
) -> dict[str, Any]:
    """Try the samples that the file does not have yet, and sum up all that it has then.

    Args:
        hands: Names or paths.
        objects: The objects.
        n: Samples over all hands and objects.
        seed: Same seed, same plans and conditions.
        file: Of the samples; made if it is not there.
        runner: Who works on them.

    Raises:
        FileFormatError: The file is not one of these, or was begun with other arguments.
        PlannerError: A hand or an object that was named cannot be used.
    """
    check_tasks(hands, objects)
    asked = {
        "format": FORMAT,
        "version": 2,
        "hands": list(hands),
        "objects": [item.spec for item in objects],
        "number": n,
        "seed": seed,
        "grades": list(GRADES),
        "conditions": list(CONDITIONS),
    }
    rows, whole = run_with_journal(
        runner,
        try_sample,
        samples_for(hands, objects, n, seed),
        file=file,
        asked=asked,
        title="plan and simulate",
        given_up=lost_sample,
    )
    return {
        "format": f"{FORMAT}-summary",
        "version": 1,
        **made_with(),
        "seed": seed,
        "interrupted": not whole,
        **summary_of_trials(rows),
    }


def summary_of_trials(rows: Iterable[dict[str, Any]]) -> dict[str, Any]:
    """Success by condition and grade, and the area under the ROC curve of every predictor.

    Args:
        rows: Of ``sim.bench.trials.try_sample``.
    """
    rows = list(rows)
    tried = [row for row in rows if row["found"]]
    return {
        "samples": len(rows),
        "simulated": len(tried),
        "held": sum(row["success"] for row in tried),
        "by_condition": _shares(tried, "condition"),
        "by_grade": _shares(tried, "grade"),
        "reasons": dict(Counter(row["reason"] for row in rows if row["reason"]).most_common()),
        "auc": {name: _areas(tried, name) for name in PREDICTORS},
    }


def _shares(tried: Sequence[dict[str, Any]], key: str) -> dict[str, dict[str, int]]:
    """How many were held of how many, by a column."""
    return {
        value: {
            "held": sum(row["success"] for row in tried if row[key] == value),
            "of": sum(row[key] == value for row in tried),
        }
        for value in dict.fromkeys(row[key] for row in tried)
    }


def _areas(tried: Sequence[dict[str, Any]], name: str) -> dict[str, dict[str, Any] | None]:
    """The area of a predictor over all, over pairs of the same task, and by condition."""

    def of(rows: Sequence[dict[str, Any]], *, grouped: bool = False) -> dict[str, Any] | None:
        values: FloatArray = np.array([row["predictors"][name] for row in rows])
        groups = [(r["hand"], r["label"], r["condition"]) for r in rows] if grouped else None
        found: Auc | None = auc(values, [row["success"] for row in rows], groups)
        return None if found is None else asdict(found)

    return {
        "all": of(tried),
        SAME: of(tried, grouped=True),
        **{c: of([r for r in tried if r["condition"] == c]) for c in CONDITIONS},
    }


def metrics_table(result: dict[str, Any]) -> Table:
    """One row per predictor, best first by the pairs of the same task."""
    conditions = list(CONDITIONS)
    columns = ["all", SAME, *conditions]
    table = table_of(
        f"area under the ROC curve, {result['simulated']} grasps, {result['held']} held "
        "(0.5 is guessing); same task: pairs of one hand, object and condition",
        ("metric",),
        ("all", "+-", *columns[1:]),
    )

    def area(name: str, column: str) -> float:
        found = result["auc"][name][column]
        return 0.0 if found is None else float(found["area"])

    for name in sorted(result["auc"], key=lambda name: -area(name, SAME)):
        areas = result["auc"][name]
        cells = [f"{areas[c]['area']:.2f}" if areas[c] else "-" for c in columns]
        error = f"{areas['all']['error']:.2f}" if areas["all"] else "-"
        table.add_row(name, cells[0], error, *cells[1:])
    table.add_section()
    held = [result["by_condition"].get(c, {"held": 0, "of": 0}) for c in conditions]
    shares = [f"{h['held']}/{h['of']}" for h in held]
    table.add_row("held", f"{result['held']}/{result['simulated']}", "", "", *shares)
    return table
