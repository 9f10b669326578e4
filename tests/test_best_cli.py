"""The options of ``plan`` that ask for the best of several grasps, or several."""

from __future__ import annotations

import json
import signal
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from planner.files import read_plan
from planner.plan import GraspPlan
from planner.search.grasp import Wanted
from sim.cli import app

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
