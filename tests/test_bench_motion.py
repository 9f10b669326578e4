"""``benchmarks.motion``: planning turns, counted."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from benchmarks.motion import OTHER_SEED, motion_table, run_motion
from planner.errors import NoGraspFoundError, NotFoundError
from planner.motion import MotionPlan, plan_motion
from sim.runner import Runner

ANGLE = np.deg2rad(30.0)


@pytest.fixture
def measure(tmp_path: Path) -> Callable[..., dict[str, Any]]:
    def run(kinds: list[str], n: int = 1) -> dict[str, Any]:
        return run_motion(
            ["allegro_hand"],
            kinds,
            n,
            height=0.08,
            angle=ANGLE,
            seed=3,
            file=tmp_path / "rows.jsonl",
            runner=Runner(console=Console(quiet=True), check=lambda: None, workers=1),
        )

    return run


def test_a_case_is_planned_once_and_kept(measure: Callable[..., dict[str, Any]]) -> None:
    (row,) = measure(["cylinder"])["rows"]
    assert row["found"] and row["exists"] and row["cpu_s"] > 0 and row["margin"] > 0
    assert measure(["cylinder"])["rows"] == [row]  # the time too: it was not planned again


def test_what_only_further_starts_find_is_there_but_not_found(
    measure: Callable[..., dict[str, Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    def unlucky(task: Any, *, seed: int, **arguments: Any) -> MotionPlan:
        if seed < OTHER_SEED:
            raise NoGraspFoundError("no luck", ())
        return plan_motion(task, seed=seed, **arguments)

    monkeypatch.setattr("benchmarks.motion.plan_motion", unlucky)
    result = measure(["cylinder"])
    (row,) = result["rows"]
    assert row["exists"] and not row["found"] and row["reason"] == "no luck"
    cells = [next(iter(column.cells)) for column in motion_table(result).columns]
    assert cells[2:4] == ["0/1", "0/1"]


def test_a_kind_that_does_not_exist_is_refused(measure: Callable[..., dict[str, Any]]) -> None:
    with pytest.raises(NotFoundError, match="cone"):
        measure(["cone"])
