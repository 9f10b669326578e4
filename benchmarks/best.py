"""Measure the best grasp after so much CPU time, for several ways to search.

``rounds R`` are independent attempts with that many rounds, of which the best is kept; ``climb`` is
``keep="best"``, whose attempts build on each other. Request k of an object has one seed for all.
The CPU time of attempts counts; what comparing independent plans costs does not.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
import typer

from benchmarks.bench import HandOptions, NumberOption, ObjectsOption
from benchmarks.common import (
    Setting,
    cells_of,
    half_longest_side,
    known,
    options_of,
    seed_of,
    task_of,
)
from benchmarks.summary import Cell, Frame, amount, of, summary, table_data
from benchmarks.synthesis import over_baseline
from planner.errors import NoGraspFoundError, TaskError
from planner.quality.ball import epsilon_frogger
from planner.search.grasp import Attempt, plan_grasp
from planner.search.metrics import Measure
from planner.task import DEFAULT_MU
from sim.cli.options import MuOption, ObjectiveOption, names
from sim.tables import Row, number

CLIMB = "climb"
"""Name of the search whose attempts build on each other."""

WAYS = ("rounds 0", "rounds 4", "rounds 8", CLIMB)
"""The ways to search that are compared."""

REFERENCE = "rounds 4"
"""What the others are divided by: the default of independent attempts."""

MANY = 10**9
"""Grasps that no budget finds."""


@dataclass(frozen=True, kw_only=True)
class Options(HandOptions):
    """Requests of every hand and object in every way."""

    n: NumberOption = 20
    objects: ObjectsOption = "sphere,box,cylinder,capsule,ellipsoid,mug"
    marks: Annotated[
        str, typer.Option(help="CPU seconds after which the best is noted, comma separated.")
    ] = "0.1,0.3,1,2.3"
    metric: ObjectiveOption = "epsilon"
    ways: Annotated[
        str, typer.Option(help="Searches, comma separated: rounds 0, rounds 4, rounds 8, climb.")
    ] = "all"
    mu: MuOption = DEFAULT_MU
    floating: Annotated[bool, typer.Option("--floating", help="No table.", metavar="")] = False


def marks_of(text: str) -> list[float]:
    """CPU seconds, ascending.

    Raises:
        TaskError: They are something else.
    """
    try:
        marks = [float(mark) for mark in names(text)]
    except ValueError as error:
        raise TaskError(f"--marks {text!r} holds something else than numbers") from error
    if marks[0] <= 0 or marks != sorted(set(marks)):
        raise TaskError(f"marks are {marks}; give CPU seconds > 0, ascending")
    return marks


def cases(options: Options) -> Iterator[Row]:
    """Requests of every hand and object; what slows the machine down meets all ways of one."""
    ways = known("search", options.ways, WAYS)
    given = {"marks": marks_of(options.marks), "metric": Measure.of(options.metric).text}
    setting = Setting(mu=options.mu, floating=options.floating)
    for cell in cells_of(options.hand_names, options.objects):
        for k in range(options.n):
            for way in ways:
                yield {**cell, "k": k, "way": way, "seed": options.seed, **given, "task": setting}


def measure(case: Row) -> Row:
    """The best value at every mark; of the plan at the last one also the baseline's epsilon."""
    task = task_of(case["hand"], case["spec"], case["task"])
    shape, metric = task.object.shape, case["metric"]
    seed = seed_of(case["seed"], shape, case["k"])
    how: dict[str, Any] = {"keep": "best", "options": options_of(None, objective=metric)}
    if case["way"] != CLIMB:
        rounds = int(case["way"].removeprefix("rounds "))
        options = options_of(rounds, objective=metric)
        how = {"best_of": MANY, "options": options, "max_attempts": MANY}
    curve: list[tuple[float, float | None]] = []
    found = 0

    def note(attempt: Attempt[Any]) -> None:
        nonlocal found
        found += attempt.plan is not None
        curve.append((attempt.cpu_s + (curve[-1][0] if curve else 0.0), attempt.best))

    plan = None
    with suppress(NoGraspFoundError):
        plan_grasp(task, seed=seed, max_attempts=1)  # prepares what all ways share
    with suppress(NoGraspFoundError):
        plan = plan_grasp(
            task, seed=seed, max_cpu_s=case["marks"][-1], metric=metric, progress=note, **how
        )
    half = half_longest_side(shape)
    return {
        "values": [value_at(curve, mark) for mark in case["marks"]],
        "frogger": None if plan is None else epsilon_frogger(plan.contacts, half_longest_side=half),
        "attempts": len(curve),
        "found": found,
    }


def value_at(curve: Sequence[tuple[float, float | None]], mark: float) -> float | None:
    """The value that a curve of (CPU s, best so far) has at a mark; None for none yet."""
    return next((v for spent, v in reversed(curve) if spent <= mark), None)


def tables(result: Row) -> Iterator[Row]:
    """Medians by object and way; then each way over the reference. No grasp counts as 0."""
    setting, rows = result["setting"], []
    marks = {f"{mark:g} s": i for i, mark in enumerate(marks_of(setting["marks"]))}
    for row in (row for row in result["rows"] if not row["error"]):
        best = {mark: row["values"][i] or 0.0 for mark, i in marks.items()}
        rows.append({**row, **best, "frogger": row["frogger"] or 0.0})
    columns: dict[str, Cell] = {mark: of(mark, digits=3) for mark in marks}
    columns["attempts"] = of("attempts", digits=0)
    columns["over its"] = lambda frame: number(over_baseline(frame, "frogger"), 2)
    yield summary(
        f"median of the best {setting['metric']} of {setting['n']} requests after CPU seconds; "
        "attempts made; FRoGGeR's epsilon at the end over its median",
        rows,
        {"hand": "hand", "object": "object", "way": "search"},
        columns,
    )
    ratios: dict[str, list[list[float | None]]] = {}

    def note(frame: Frame) -> str:
        medians = {way: group for way, group in frame.groupby("way", sort=False)}
        for way, group in medians.items():
            over: list[float | None] = []
            for mark in marks:
                theirs = amount(medians[REFERENCE], mark) if REFERENCE in medians else None
                over.append((amount(group, mark) or 0.0) / theirs if theirs else None)
            ratios.setdefault(way, []).append([*over, over_baseline(group, "frogger")])
        return ""

    summary("", rows, ("hand", "object"), {"": note})
    yield table_data(
        f"over {REFERENCE} after the same CPU seconds: median over objects (least)",
        ("search",),
        (*marks, "over its"),
        [
            [way, *(_median_and_least(column) for column in zip(*lines, strict=True))]
            for way, lines in ratios.items()
        ],
    )


def _median_and_least(values: Sequence[float | None]) -> str:
    there = [v for v in values if v is not None]
    return f"{np.median(there):.2f} ({min(there):.2f})" if there else "-"
