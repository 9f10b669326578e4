"""``run_metrics``: which metric predicts what happens in simulation.

Samples (``sim.bench.trials``) are appended to a file of JSON lines as they come, the first of which
says what was asked for. A run that was interrupted or killed goes on with the same command.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from planner.errors import FileFormatError, TaskError
from planner.spatial import FloatArray
from sim.bench.auc import Auc, auc
from sim.bench.objects import BenchObject
from sim.bench.predictors import PREDICTORS
from sim.bench.requests import Setting, loaded_hand, task_for
from sim.bench.run import made_with, run_all
from sim.bench.tables import table_of
from sim.bench.trials import CONDITIONS, GRADES, Sample, try_sample

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
    workers: int,
    console: Console,
    check: Callable[[], None],
) -> dict[str, Any]:
    """Try the samples that the file does not have yet, and sum up all that it has then.

    Args:
        hands: Names or paths.
        objects: The objects.
        n: Samples over all hands and objects.
        seed: Same seed, same plans and conditions.
        file: JSON lines; made if it is not there.
        workers: Processes.
        console: Where the progress bar goes.
        check: Raises a KeyboardInterrupt that a solver swallowed.

    Raises:
        FileFormatError: The file is not one of these, or was begun with other arguments.
        PlannerError: A hand or an object cannot be used.
    """
    for hand in hands:
        loaded_hand(hand)
        for item in objects:
            task = task_for(hand, item.spec, Setting())
            if isinstance(task, str):
                raise TaskError(task)
    samples = samples_for(hands, objects, n, seed)
    asked = {"format": FORMAT, "version": 1, "samples": [asdict(s) for s in samples]}
    rows = _read(file, asked)
    done = {row["index"] for row in rows}
    with file.open("a", encoding="utf-8") as stream:

        def keep(row: dict[str, Any]) -> None:
            rows.append(row)
            stream.write(json.dumps(row) + "\n")
            stream.flush()

        finished = run_all(
            try_sample,
            [s for s in samples if s.index not in done],
            workers=workers,
            title="plan and simulate",
            console=console,
            keep=keep,
            check=check,
        )
    return {
        "format": f"{FORMAT}-summary",
        "version": 1,
        **made_with(),
        "seed": seed,
        "interrupted": not finished,
        **summary_of_trials(rows),
    }


def _read(file: Path, asked: dict[str, Any]) -> list[dict[str, Any]]:
    """Rows that a file has; what is asked for is written into a new one.

    A last line that was cut short is cut off: its sample is tried again.
    """
    if not file.exists():
        file.write_text(json.dumps(asked) + "\n", encoding="utf-8")
        return []
    text = file.read_text(encoding="utf-8")
    whole = text[: text.rfind("\n") + 1]
    try:
        header, *rows = [json.loads(line) for line in whole.splitlines()]
    except ValueError as error:
        raise FileFormatError(
            f"{file} is not a file of bench metrics, or damaged: {error}; name another"
        ) from error
    if header != asked:
        raise FileFormatError(
            f"{file} was begun with other arguments (hands, objects, number or seed); give the "
            "same, or another file"
        )
    if whole != text:
        file.write_text(whole, encoding="utf-8")
    return rows


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
