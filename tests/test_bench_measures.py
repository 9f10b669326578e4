"""Each measurement, of one tiny case: nothing fails, and its tables have what they are made of."""

from __future__ import annotations

import json
from typing import Any

import pytest
from benching import run_bench

from benchmarks.best import value_at
from benchmarks.metrics import CONDITIONS
from benchmarks.synthesis import summed
from sim.tables import Row

ONE: dict[str, Any] = {"hands": ["allegro_hand"], "n": 1}
BALL = {**ONE, "objects": "sphere"}

QUICK: list[tuple[str, Row]] = [
    ("grasps", BALL),
    ("objectives", {**BALL, "objectives": "none,epsilon"}),
    ("best", {**BALL, "marks": "0.05,0.1", "ways": "rounds 0,climb"}),
    ("walls", {**ONE, "objects": "cup", "trials": 0}),
    ("refine", {**BALL, "shifts": "5", "turns": "0.1"}),
    ("audit", {**BALL, "faulty": 1, "timed": 2}),
    ("whole", {**BALL, "parts": "push"}),
]
SLOW: list[tuple[str, Row]] = [
    ("metrics", {**BALL, "n": 2}),
    ("synthesis", {**BALL, "rounds": 0, "baseline": True}),
    ("trials", {**BALL, "controllers": "feedforward", "repeats": 1}),
    ("motion", {**ONE, "objects": "cylinder", "rotate": 20.0}),
    ("manipulate", {**ONE, "rotate": "y:15"}),
    ("control", {**BALL, "parts": "fc"}),
    ("physics", {**BALL, "parts": "remedies"}),
    ("touch", {**ONE, "parts": "arrays"}),
    ("clouds", {**BALL, "ways": "cloud,mesh,hull", "views": "2", "error_model": "ideal"}),
]


@pytest.mark.usefixtures("brief_trials")
@pytest.mark.parametrize(
    ("name", "asked"),
    [*QUICK, *(pytest.param(*one, marks=pytest.mark.slow) for one in SLOW)],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_a_tiny_case_is_measured(name: str, asked: Row) -> None:
    result = run_bench(name, **asked)
    assert result["rows"] and not result["interrupted"]
    assert {row["error"] for row in result["rows"]} == {""}
    tables = [one for one in result["summary"] if not isinstance(one, str)]
    assert tables
    for table in tables:
        assert set(table["left"]) <= set(table["columns"])
        assert all(len(row) == len(table["columns"]) for row in table["rows"])
    lines = [(table["columns"], row) for table in tables for row in table["rows"]]
    cells = [pair for columns, row in lines for pair in zip(columns, row, strict=True)]
    filled = {column for column, text in cells if text not in ("-", "")}
    empty = {c for t in tables if t["rows"] for c in t["columns"]} - filled
    assert empty <= EMPTY.get(name, set()), empty
    json.dumps(result, allow_nan=False)


EMPTY = {
    "grasps": {"path mm", "path deg"},  # of two hands
    "synthesis": {"ratio"},  # no figure of FRoGGeR's for a sphere
    "best": {"over its"},
    "walls": {"failed attempts by reason", "wall mm"},
    "metrics": {"all", "+-", "same task", *CONDITIONS},
    "physics": {"reasons"},
    "clouds": {"rightly"},
}
"""Columns that a tiny case leaves empty."""


def test_a_curve_has_the_value_of_the_last_attempt_that_ended_by_then() -> None:
    curve = [(0.1, None), (0.2, 1.0), (0.4, 3.0)]
    marks = (0.05, 0.1, 0.3, 0.4, 9.0)
    assert [value_at(curve, mark) for mark in marks] == [None, None, 1.0, 3.0, 3.0]


def test_requests_add_up() -> None:
    def request(cpu: float, found: bool, passed: int | None = 1) -> Row:
        spent = {"solve": 0.5 * cpu, "approach": 0.25 * cpu, "other": 0.25 * cpu}
        made = {"found": found, "attempts": 2, "cpu_s": cpu, "prepare_s": 0.5, "stages": spent}
        made |= {"reasons": {} if found else {"gap": 2}, "passed": passed}
        return made | {"n_fingers": 3, "epsilon": 0.1, "epsilon_frogger": 0.2, "clearance_mm": 1.0}

    row = summed([request(1.0, True), request(2.0, True), request(4.0, False, 0)])
    counts = ("requested", "found", "attempts", "cpu_s", "prepare_s", "soon")
    assert [row[name] for name in counts] == [3, 2, 6, 7.0, 1.5, 1]
    assert row["taken_s"] == [1.0, 2.0] and row["epsilon"] == [0.1, 0.1]
    assert row["stages"] == {"solve": 3.5, "approach": 1.75, "other": 1.75}
    assert row["reasons"] == {"gap": 2}
    # without the check of the way in: 2 that passed the others, in 7 s less that stage
    assert (row["passed"], row["without_s"]) == (2, 5.25)
    assert summed([request(1.0, True, None)])["without_s"] is None
