"""The options of ``plan`` that ask for the best of several grasps, or several; ``bench best``."""

from __future__ import annotations

import json
import signal
from pathlib import Path

import pytest
from rich.console import Console
from typer.testing import CliRunner, Result

from benchmarks.best import WAYS, best_tables, run_best, summary_of_ways, value_at
from benchmarks.objects import bench_objects
from benchmarks.requests import Setting
from planner.best import Wanted
from planner.errors import TaskError
from planner.files import read_plan
from planner.plan import GraspPlan
from sim.cli import app
from sim.runner import Runner

CYLINDER = ("allegro_hand", "cylinder", "--rounds", "0")


def plan(*words: object) -> Result:
    """The command."""
    return CliRunner().invoke(app, ["plan", *map(str, words)])


def test_the_best_of_so_many(tmp_path: Path) -> None:
    file = tmp_path / "plan.json"
    told = plan(*CYLINDER, "--best-of", 3, "--metric", "limits", "-o", file)
    assert told.exit_code == 0, told.output
    assert "the best of 3 found" in told.output and "by limits" in told.output
    best = read_plan(file).record.best
    assert best is not None and (best.found, best.metric, best.improving) == (3, "limits", False)


def test_keep_best_spends_its_budget(tmp_path: Path) -> None:
    file = tmp_path / "plan.json"
    told = plan(*CYLINDER, "--keep", "best", "--max-attempts", 5, "-o", file)
    assert told.exit_code == 0, told.output
    record = read_plan(file).record
    assert record.attempts == 5 and record.best is not None and record.best.improving


def interrupted_at(monkeypatch: pytest.MonkeyPatch, found: int, times: int = 1) -> None:
    """Press Ctrl-C when so many grasps were found."""
    seen: list[GraspPlan] = []
    value = Wanted.value

    def pressed(self: Wanted, plan: GraspPlan) -> float:
        seen.append(plan)
        if len(seen) == found:
            for _ in range(times):
                signal.raise_signal(signal.SIGINT)
        return value(self, plan)

    monkeypatch.setattr(Wanted, "value", pressed)


def test_ctrl_c_keeps_the_best_so_far(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    interrupted_at(monkeypatch, found=2)
    file = tmp_path / "plan.json"
    told = plan(*CYLINDER, "--best-of", 1000, "-o", file)
    assert told.exit_code == 0, told.output
    assert "interrupted: the best of 2 found" in " ".join(told.output.split())
    best = read_plan(file).record.best
    assert best is not None and best.found == 2


def test_ctrl_c_twice_ends_the_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    interrupted_at(monkeypatch, found=2, times=2)
    told = plan(*CYLINDER, "--best-of", 1000, "-o", tmp_path / "plan.json")
    assert told.exit_code == 130
    assert not list(tmp_path.iterdir())


def test_several_that_differ_go_to_numbered_files(tmp_path: Path) -> None:
    told = plan(*CYLINDER, "-n", 3, "--diverse", "-o", tmp_path / "plan.json")
    assert told.exit_code == 0, told.output
    assert sorted(p.name for p in tmp_path.iterdir()) == [f"plan-{k}.json" for k in (1, 2, 3)]
    assert "near-duplicates are at most 1" in told.output
    attempts = {read_plan(p).record.attempt for p in tmp_path.iterdir()}
    assert len(attempts) == 3
    told = plan(*CYLINDER, "-n", 2, "--json", "-o", tmp_path / "two.json")
    assert len(json.loads(told.stdout)["plans"]) == 2


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--keep", "bset"], "Did you mean 'best'"),
        (["--best-of", "3", "--metric", "epsilno"], "Did you mean 'epsilon'"),
        (["--metric", "torque"], "give best_of or keep='best' too"),
        (["--diverse"], "one grasp cannot be diverse"),
        (["-n", "3", "--keep", "best"], "leave one out"),
    ],
)
def test_bad_options_are_told_in_a_line(tmp_path: Path, words: list[str], message: str) -> None:
    told = plan(*CYLINDER, *words, "-o", tmp_path / "plan.json")
    assert told.exit_code == 3
    assert message in " ".join(told.output.split())
    assert not list(tmp_path.iterdir())


def test_no_grasp_at_all_is_wrong_usage() -> None:
    assert plan(*CYLINDER, "--best-of", 0).exit_code == 2
    assert plan(*CYLINDER, "-n", 0).exit_code == 2


def test_a_curve_has_the_value_of_the_last_attempt_that_ended_by_then() -> None:
    curve = [(0.1, None), (0.2, 1.0), (0.4, 3.0)]
    assert [value_at(curve, mark) for mark in (0.05, 0.1, 0.3, 0.4, 9.0)] == [
        None,
        None,
        1.0,
        3.0,
        3.0,
    ]


def test_the_summary_divides_by_independent_attempts() -> None:
    def row(way: str, k: int, *values: float | None) -> dict[str, object]:
        return {
            "hand": "h",
            "object": "013_apple",
            "way": way,
            "k": k,
            "values": list(values),
            "frogger": values[-1],
            "attempts": 3,
        }

    rows = [row("rounds 4", 0, None, 0.2), row("rounds 4", 1, 0.1, 0.2), row("climb", 0, 0.1, 0.3)]
    first, second = summary_of_ways(rows)
    assert first["medians"] == [pytest.approx(0.05), pytest.approx(0.2)]  # none counts as 0
    assert second["over_reference"] == [pytest.approx(2.0), pytest.approx(1.5)]
    assert second["over_baseline"] == pytest.approx(0.3 / 0.230)


def test_bench_best_measures_all_ways(tmp_path: Path) -> None:
    result = run_best(
        ["allegro_hand"],
        bench_objects(["sphere"]),
        1,
        marks=[0.05, 0.1],
        metric="epsilon",
        setting=Setting(floating=True),
        runner=Runner(console=Console(quiet=True), check=lambda: None),
    )
    assert [row["way"] for row in result["rows"]] == list(WAYS)
    assert all(row["found"] for row in result["rows"])
    json.dumps(result)
    console = Console(width=150, record=True)
    console.print(*best_tables(result))
    assert "climb" in console.export_text()


def test_bench_best_refuses_what_it_cannot_measure() -> None:
    with pytest.raises(TaskError, match="give CPU seconds > 0, ascending"):
        run_best(
            ["allegro_hand"],
            [],
            1,
            marks=[0.3, 0.1],
            metric="epsilon",
            setting=Setting(),
            runner=Runner(console=Console(quiet=True), check=lambda: None),
        )
    told = CliRunner().invoke(app, ["bench", "best", "allegro_hand", "--ways", "clim"])
    assert told.exit_code == 3 and "Did you mean 'climb'" in " ".join(told.output.split())
