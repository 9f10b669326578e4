"""``run_metrics``: which metric predicts what happens in simulation."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from benchmarks.auc import auc
from benchmarks.objects import BenchObject
from benchmarks.predictors import PREDICTORS
from benchmarks.requests import check_tasks
from benchmarks.run import measure, stated
from benchmarks.trials import CONDITIONS, GRADES, Sample, try_sample
from planner.spatial import FloatArray
from sim.reality import Reality
from sim.runner import Runner
from sim.tables import Row, grouped, share, table_of

FORMAT = "opposable-bench-metrics"
SAME = "same task"
"""Column of pairs of the same hand, object and condition: which of two grasps of this object?"""


def samples_for(
    hands: Sequence[str],
    objects: Sequence[BenchObject],
    n: int,
    seed: int,
    reality: Reality | None = None,
) -> list[Sample]:
    """N samples: cell after cell, in each of them conditions and grades equally often."""
    reality = reality or Reality()
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
                reality=reality,
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
    reality: Reality | None = None,
) -> Row:
    """Try n samples over all hands and objects, and sum up all that the file has then."""
    check_tasks(hands, objects)
    reality = reality or Reality()
    asked = {
        "format": FORMAT,
        "version": 3,
        "hands": list(hands),
        "objects": [item.spec for item in objects],
        "number": n,
        "seed": seed,
        "grades": list(GRADES),
        "conditions": list(CONDITIONS),
        **stated(reality),
    }
    result = measure(
        runner,
        try_sample,
        samples_for(hands, objects, n, seed, reality),
        kind=f"{FORMAT}-summary",
        title="plan and simulate",
        lost=Sample.lost,
        file=file,
        asked=asked,
        seed=seed,
        **stated(reality),
    )
    return result | summary_of_trials(result.pop("rows"))


def summary_of_trials(rows: Sequence[Row]) -> Row:
    """Success by condition and grade, and the area under the ROC curve of every predictor.

    Args:
        rows: Of ``benchmarks.trials.try_sample``.
    """
    tried = [row for row in rows if row["found"]]

    def held(by: str) -> Row:
        cells = {value: members for (value,), members in grouped(tried, by).items()}
        return {v: {"held": sum(r["success"] for r in m), "of": len(m)} for v, m in cells.items()}

    return {
        "samples": len(rows),
        "simulated": len(tried),
        "held": sum(row["success"] for row in tried),
        "by_condition": held("condition"),
        "by_grade": held("grade"),
        "reasons": dict(Counter(row["reason"] for row in rows if row["reason"]).most_common()),
        "auc": {name: _areas(tried, name) for name in PREDICTORS},
    }


def _areas(tried: Sequence[Row], name: str) -> dict[str, Row | None]:
    """The area of a predictor over all, over pairs of the same task, and by condition."""

    def area(rows: Sequence[Row], groups: Sequence[Any] | None = None) -> Row | None:
        values: FloatArray = np.array([row["predictors"][name] for row in rows])
        found = auc(values, [row["success"] for row in rows], groups)
        return None if found is None else asdict(found)

    return {
        "all": area(tried),
        SAME: area(tried, [(r["hand"], r["object"], r["condition"]) for r in tried]),
        **{c: area([r for r in tried if r["condition"] == c]) for c in CONDITIONS},
    }


def metrics_table(result: Row) -> Table:
    """One row per predictor, best first by the pairs of the same task."""
    columns = ["all", SAME, *CONDITIONS]
    table = table_of(
        f"area under the ROC curve, {result['simulated']} grasps, {result['held']} held "
        "(0.5 is guessing); same task: pairs of one hand, object and condition",
        ("metric",),
        ("all", "+-", *columns[1:]),
    )

    def cell(found: Row | None, value: str = "area") -> str:
        return f"{found[value]:.2f}" if found else "-"

    areas = result["auc"]
    best_first = sorted(areas, key=lambda n: -(areas[n][SAME] or {"area": 0.0})["area"])
    for name in best_first:
        first, *others = (cell(areas[name][c]) for c in columns)
        table.add_row(name, first, cell(areas[name]["all"], "error"), *others)
    table.add_section()
    shares = result["by_condition"]
    told = [f"{s['held']}/{s['of']}" if (s := shares.get(c)) else share(()) for c in CONDITIONS]
    table.add_row("held", f"{result['held']}/{result['simulated']}", "", "", *told)
    return table
