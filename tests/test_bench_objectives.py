"""``bench objectives``: summaries of made-up requests, one small run, and the command."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, get_args

import pytest
from rich.console import Console
from typer.testing import CliRunner

from benchmarks.objectives import objective_tables, run_objectives, summary_of_objective
from benchmarks.objects import bench_objects
from planner.errors import NotFoundError, PlannerError, TaskError
from planner.plan_metrics import METRICS
from planner.synthesis import OBJECTIVES
from sim.cli import app
from sim.cli.options import ObjectiveOption
from sim.runner import Runner


def row(objective: str, k: int, attempts: int, value: float | None) -> dict[str, Any]:
    """A request whose plan has this value by every measure; None for no plan."""
    return {
        "hand": "h",
        "object": "o",
        "objective": objective,
        "k": k,
        "attempts": attempts,
        "cpu_s": 0.1 * attempts,
        "measures": None if value is None else dict.fromkeys(METRICS, value),
    }


ROWS = [
    row("none", 0, 1, 1.0),
    row("none", 1, 2, 2.0),
    row("none", 2, 5, None),
    row("torque", 0, 1, 3.0),
    row("torque", 1, 4, 1.0),
    row("torque", 2, 3, 7.0),
]


def test_summary_counts_attempts_medians_and_pairs() -> None:
    summary = summary_of_objective("torque", ROWS)
    assert (summary["requested"], summary["found"], summary["attempts"]) == (3, 3, 8)
    assert summary["found_per_attempt"] == pytest.approx(3 / 8)
    assert summary["cpu_s_per_attempt"] == pytest.approx(0.1)
    assert summary["cpu_s_per_found"] == pytest.approx(0.8 / 3)
    assert summary["medians"]["torque"] == 3.0
    # request 2 has no partner: of the two others one is better
    assert summary["better_than_none"]["torque"] == pytest.approx(0.5)
    assert summary["cells"][0]["medians"]["limits"] == 3.0


def test_nothing_found_is_a_row_without_figures() -> None:
    summary = summary_of_objective("none", [row("none", 0, 5, None)])
    assert summary["cpu_s_per_found"] is None
    assert summary["medians"]["epsilon"] is None
    result = {"units": {n: m.unit for n, m in METRICS.items()}, "objectives": [summary]}
    tables = objective_tables(result)
    assert len(tables) == 1
    assert tables[0].row_count == 1


def test_medians_stand_beside_those_of_their_own_cell() -> None:
    # Ctrl-C came before the first object was tried without an objective
    rows = [
        row("none", 0, 1, 2.0) | {"object": "second"},
        row("torque", 0, 1, 3.0) | {"object": "first"},
        row("torque", 0, 1, 4.0) | {"object": "second"},
    ]
    summaries = [summary_of_objective(name, rows) for name in ("none", "torque")]
    units = {name: metric.unit for name, metric in METRICS.items()}
    own = objective_tables({"units": units, "objectives": summaries})[1]
    columns = [list(column.cells) for column in own.columns]
    shown = list(zip(*columns, strict=True))
    assert shown[0][2:5] == ("first", "-", "3.")
    assert shown[1][2:5] == ("second", "2.", "4.")


def test_a_bad_mesh_out_of_a_folder_is_a_row_and_one_that_was_named_an_error(
    tmp_path: Path,
) -> None:
    (tmp_path / "open.obj").write_text("v 0 0 0\nv 0.05 0 0\nv 0 0.05 0\nf 1 2 3\n")
    result = run(["none"], [str(tmp_path), "sphere"])
    by_object = {r["object"]: r for r in result["rows"] if r["k"] == 0}
    assert "not closed" in by_object["open"]["error"]
    assert by_object["open"]["measures"] is None
    assert by_object["sphere"]["measures"] is not None
    assert result["objectives"][0]["requested"] == 4
    with pytest.raises(PlannerError, match="not closed"):
        run(["none"], [str(tmp_path / "open.obj")])


def test_a_request_that_cannot_be_tried_is_a_row(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise TaskError("no pads left")

    monkeypatch.setattr("benchmarks.objectives.attempts", refuse)
    rows = run(["none"])["rows"]
    assert [r["error"] for r in rows] == ["no pads left"] * 2


def run(objectives: list[str], objects: Sequence[str] = ("sphere",)) -> dict[str, Any]:
    return run_objectives(
        ["allegro_hand"],
        bench_objects(objects),
        2,
        objectives=objectives,
        seed=0,
        max_attempts=20,
        runner=Runner(console=Console(quiet=True), check=lambda: None),
    )


def test_a_run_has_a_row_per_request_and_a_summary_per_objective() -> None:
    result = run(["none", "limits:2"])
    assert [r["k"] for r in result["rows"]] == [0, 1, 0, 1]
    assert [e["objective"] for e in result["objectives"]] == ["none", "limits:2.0"]
    assert all(set(r["measures"]) == set(METRICS) for r in result["rows"])
    json.dumps(result)


def test_an_unknown_objective_ends_before_the_work() -> None:
    with pytest.raises(NotFoundError, match="no objective is called 'strong'"):
        run(["strong"])


def test_the_command_prints_both_tables_and_writes_the_figures(tmp_path: Path) -> None:
    out = tmp_path / "figures.json"
    line = "bench objectives allegro_hand --objects sphere -n 1"
    line += f" --objectives none,epsilon:1+limits:1,limits --out {out}"
    told = CliRunner().invoke(app, line.split())
    assert told.exit_code == 0, told.output
    assert "epsilon,limits" in told.output
    assert "its own measure" in told.output
    assert json.loads(out.read_text())["format"] == "opposable-bench-objectives"


def test_all_are_none_and_each_objective_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []

    def note(*_: object, objectives: list[str], **__: object) -> None:
        asked.extend(objectives)
        raise TaskError("that is enough")

    monkeypatch.setattr("benchmarks.objectives.run_objectives", note)
    CliRunner().invoke(app, ["bench", "objectives", "allegro_hand"])
    assert asked == ["none", *OBJECTIVES]


def test_the_help_names_every_objective() -> None:
    option = get_args(ObjectiveOption)[1]
    assert f"{', '.join(OBJECTIVES)}; several" in option.help


def test_a_plan_is_made_for_an_objective_and_says_so(tmp_path: Path) -> None:
    file = tmp_path / "plan.json"
    line = f"plan allegro_hand sphere --seed 1 --objective task:2,limits -o {file}"
    line += " --task-wrench -1,0,0,0,0,0.1 --task-wrench 0,0,0,0,0.05,0"
    told = CliRunner().invoke(app, line.split())
    assert told.exit_code == 0, told.output
    assert json.loads(file.read_text())["record"]["objective"] == "task:2.0,limits"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("--objective strength", "no objective is called 'strength'"),
        ("--objective task --task-wrench 1,2", "has 2 numbers; give six"),
        ("--objective task --task-wrench 1,2,3,x,5,6", "something else than numbers"),
        ("--task-wrench 1,2,3,4,5,6", "add 'task'"),
    ],
)
def test_wrong_objectives_are_bad_input(options: str, message: str) -> None:
    told = CliRunner().invoke(app, ["plan", "allegro_hand", "sphere", *options.split()])
    assert told.exit_code == 3
    assert message in " ".join(told.output.split())
