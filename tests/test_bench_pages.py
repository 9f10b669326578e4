"""``bench pages``: what it measures of a page, and that it notices what is wrong."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import need_browser
from rich.console import Console

from benchmarks import pages
from benchmarks.pages import pages_table, run_pages
from benchmarks.pages_cases import KINDS, Made, make_report
from planner.errors import PlannerError
from sim.runner import Runner

RUNNER = Runner(console=Console(quiet=True), check=lambda: None)

GOOD: dict[str, Any] = {
    "kind": "trial",
    "hand": "a hand",
    "object": "a sphere",
    "outcome": "held",
    "errors": [],
    "requests": [],
    "blank": False,
    "off_mm": 0.001,
    "mujoco_off_mm": 0.001,
    "opened_off_s": 0.0,
    "write_s": 0.3,
    "write_cpu_s": 0.2,
    "MB": 0.6,
}


@pytest.mark.parametrize(
    "fault",
    [
        {"errors": ["x is not defined"]},
        {"requests": ["https://example.org/three.js"]},
        {"blank": True},
        {"off_mm": 1.5},
        {"mujoco_off_mm": 1.5},
        {"opened_off_s": 0.5},
        {"write_cpu_s": 2.5},
        {"MB": 3.1},
    ],
)
def test_every_fault_counts(fault: dict[str, Any]) -> None:
    def told(*rows: dict[str, Any]) -> str:
        return str(pages_table({"rows": list(rows)})[1])

    assert told(GOOD, GOOD).startswith("2 of 2 pages are good")
    assert told(GOOD, GOOD | fault).startswith("1 of 2 pages are good")
    if "MB" in fault:  # a full turn may be larger
        assert told(GOOD | fault | {"kind": "full turn"}).startswith("1 of 1")


def test_every_kind_of_report_is_drawn() -> None:
    for n in (5, 20, 200):
        drawn = pages._kinds(n, seed=0)
        assert len(drawn) == n and set(drawn) == set(KINDS)
    assert pages._kinds(200, seed=0) != pages._kinds(200, seed=1)


def test_it_works_in_one_process() -> None:
    with pytest.raises(PlannerError, match="one process"):
        run_pages(1, file=None, runner=replace(RUNNER, workers=2))


def test_a_page_is_written_opened_and_measured(tmp_path: Path, monkeypatch: Any) -> None:
    need_browser()
    monkeypatch.setattr(pages, "_kinds", lambda n, seed: ["trial", "plan"])
    result = run_pages(2, seed=3, folder=tmp_path, file=None, runner=RUNNER)
    assert str(pages_table(result)[1]).startswith("2 of 2 pages are good"), result["rows"]
    assert len(list(tmp_path.glob("*.html"))) == 2
    assert all(0.0 < row["MB"] < 3.0 for row in result["rows"])


def test_states_that_the_page_does_not_show_are_noticed(tmp_path: Path, monkeypatch: Any) -> None:
    need_browser()

    def wrong(kind: Any, rng: np.random.Generator) -> Made:
        made = make_report(kind, rng)
        assert made.states is not None
        q = made.states.q.copy()
        q[:, 1] += 0.05
        moved = made.states.T_world_object + np.array([0.002, 0, 0, 0, 0, 0, 0])
        return replace(made, states=replace(made.states, q=q, T_world_object=moved))

    monkeypatch.setattr(pages, "_kinds", lambda n, seed: ["plan"])
    monkeypatch.setattr(pages, "make_report", wrong)
    (row,) = run_pages(1, seed=3, folder=tmp_path, file=None, runner=RUNNER)["rows"]
    assert row["off_mm"] == pytest.approx(2.0, abs=0.01)
    assert row["mujoco_off_mm"] > 1.0
