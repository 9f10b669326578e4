"""The benchmark of random force programmes, on few of them, and that it can tell errors."""

from __future__ import annotations

import json
from itertools import pairwise
from typing import Any

import pytest
from rich.console import Console
from typer.testing import CliRunner

from benchmarks.forces import SIDES, TOLERANCES, force_tables, run_forces
from planner.forces import distribute_forces, solver_names
from sim.cli import app
from sim.runner import Runner

HERE = Runner(console=Console(quiet=True), check=lambda: None)
"""Works here, shows nothing, and never finds Ctrl-C."""


@pytest.fixture(scope="module")
def result() -> dict[str, Any]:
    pytest.importorskip("clarabel")
    return run_forces(40, seed=1, runner=HERE)


def test_nothing_contradicts_theory(result: dict[str, Any]) -> None:
    theory = dict(result["theory"])
    assert (theory.pop("programmes"), result["interrupted"], result["given_up"]) == (40, False, 0)
    assert 10 < theory.pop("cone holds") < 38
    assert theory.pop("pyramids that hold nothing") > 40
    assert set(theory.values()) == {0}


def test_the_gap_to_the_cone_falls_with_the_sides_of_point_contacts(
    result: dict[str, Any],
) -> None:
    for cone in ("inscribed", "circumscribed"):
        mine = [g for g in result["gaps"] if (g["contacts"], g["cone"]) == ("point", cone)]
        assert [g["sides"] for g in mine] == list(SIDES)
        medians = [g["cost_median"] for g in mine]
        assert all(b < 0.7 * a for a, b in pairwise(medians))


def test_solvers_are_judged_by_what_is_recomputed(result: dict[str, Any]) -> None:
    table = result["solvers"]
    assert len(table) == len(TOLERANCES) * len(solver_names())
    for s in table:
        assert s["solved"] + s["refused"] + s["failed"] == 40
        assert s["violation"] <= s["tolerance"]
        assert s["missed"] <= s["tolerance"]
        assert s["failed"] == 0, s
    exact = [s for s in table if s["solver"] == "daqp"]
    assert all(s["only_within_tolerance"] == 0 for s in exact)


def test_same_seed_same_programmes(result: dict[str, Any]) -> None:
    again = run_forces(3, seed=1, runner=HERE)
    for a, b in zip(again["rows"], result["rows"], strict=False):
        assert a["holds"] == b["holds"]
        assert a["cost"] == pytest.approx(b["cost"])


def test_errors_would_be_told(result: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    """Pyramids taken for their opposites contradict theory."""
    other = {"inscribed": "circumscribed", "circumscribed": "inscribed"}

    def swapped(contacts: Any, **given: Any) -> Any:
        return distribute_forces(contacts, **{**given, "cone": other.get(given["cone"], "round")})

    monkeypatch.setattr("benchmarks.forces.distribute_forces", swapped)
    monkeypatch.setattr("benchmarks.forces.TOLERANCES", ())
    theory = run_forces(40, seed=1, runner=HERE)["theory"]
    assert theory["inscribed holds, cone does not"] > 0
    assert theory["inscribed is cheaper than the cone"] > 20
    assert theory["cone is cheaper than circumscribed"] > 20


def test_the_command(result: dict[str, Any]) -> None:
    done = CliRunner().invoke(app, ["bench", "forces", "-n", "2", "--json"])
    assert done.exit_code == 0, done.output
    data = json.loads(done.output[done.output.index("{") :], parse_constant=pytest.fail)
    assert data["format"] == "opposable-bench-forces"
    assert [t.row_count for t in force_tables(result)] == [10, 16, len(result["solvers"])]
