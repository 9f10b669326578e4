"""The benchmark of random force programmes, on few of them, and that it can tell errors."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import pytest
from benching import run_bench

from benchmarks import forces
from benchmarks.forces import SIDES, TOLERANCES
from planner.forces import distribute_forces, solver_names


@pytest.fixture(scope="module")
def result() -> dict[str, Any]:
    pytest.importorskip("clarabel")
    return run_bench("forces", n=40, seed=1)


def test_nothing_contradicts_theory(result: dict[str, Any]) -> None:
    theory = {what: int(n) for what, n in result["summary"][0]["rows"]}
    assert theory.pop("programmes") == 40
    assert 10 < theory.pop("cone holds") < 38
    assert theory.pop("pyramids that hold nothing") > 40
    assert set(theory.values()) == {0}


def test_the_gap_to_the_cone_falls_with_the_sides_of_point_contacts(
    result: dict[str, Any],
) -> None:
    for cone in ("inscribed", "circumscribed"):
        mine = [row for row in result["summary"][1]["rows"] if row[:2] == ["point", cone]]
        assert [int(row[2]) for row in mine] == list(SIDES)
        assert all(float(b[5]) < 0.7 * float(a[5]) for a, b in pairwise(mine))


def test_solvers_are_judged_by_what_is_recomputed(result: dict[str, Any]) -> None:
    table = result["summary"][2]["rows"]
    assert len(table) == len(TOLERANCES) * len(solver_names())
    for name, tolerance, solved, refused, failed, hair, violation, missed in table:
        assert int(solved) + int(refused) + int(failed) == 40
        assert max(float(violation), float(missed)) <= float(tolerance)
        assert failed == "0" and (name != "daqp" or hair == "0")


def test_errors_would_be_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """A cone that is called infeasible where it is not contradicts theory."""
    pytest.importorskip("clarabel")
    true = distribute_forces

    def wrong(*args: Any, **options: Any) -> Any:
        answer = true(*args, **options)
        if options.get("cone") == "round":
            return type("None", (), {"found": False, "cost": 0.0})()
        return answer

    monkeypatch.setattr(forces, "distribute_forces", wrong)
    theory = dict(run_bench("forces", n=6, seed=1)["summary"][0]["rows"])
    assert int(theory["inscribed holds, cone does not"]) > 0
