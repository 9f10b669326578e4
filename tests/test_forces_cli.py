"""``opposable analyse --forces``: the problem by name, solvers compared, pyramids and cone."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from planner import GraspTask, plan_grasp
from planner.files import write_plan
from sim.cli import app

RUN = CliRunner()


@pytest.fixture(scope="module")
def plan_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("forces") / "plan.json"
    write_plan(plan_grasp(GraspTask.create("allegro_hand", "box"), seed=0), path)
    return path


def test_the_problem_and_its_answer(plan_file: Path) -> None:
    done = RUN.invoke(app, ["analyse", str(plan_file), "--forces"])
    assert done.exit_code == 0, done.output
    for words in ("thumb f_n", "force x:", "friction of thumb: 8 faces", "forces found by daqp"):
        assert words in done.output
    assert "thumb: normal" in done.output


def test_solvers_on_a_plan(plan_file: Path) -> None:
    arguments = [
        "analyse",
        str(plan_file),
        "--forces",
        "--solvers",
        "daqp,osqp",
        "--steps",
        "30",
        "--json",
    ]
    done = RUN.invoke(app, arguments)
    data = json.loads(done.output, parse_constant=pytest.fail)  # NaN is no JSON
    records = data["solvers"]["records"]
    assert [r["solver"] for r in records] == ["daqp", "osqp"]
    assert all(r["solved"] + r["refused"] + r["failed"] == 30 for r in records)
    assert (records[0]["failed"], done.exit_code) == (0, int(records[1]["failed"] > 0))
    assert len(data["forces"]) == 4
    table = RUN.invoke(app, [*arguments[:-1]])
    assert "30 programmes of 12 unknowns" in table.output


def test_pyramids_beside_the_cone_on_a_plan(plan_file: Path) -> None:
    pytest.importorskip("clarabel")
    done = RUN.invoke(app, ["analyse", str(plan_file), "--forces", "--gaps", "--steps", "3"])
    assert done.exit_code == 0, done.output
    assert "circumscribed" in done.output


def test_bad_input_is_told(plan_file: Path) -> None:
    done = RUN.invoke(app, ["analyse", str(plan_file), "--forces", "--solvers", "osqq"])
    assert done.exit_code == 3
    done = RUN.invoke(app, ["analyse", str(plan_file), "--solvers", "daqp"])
    assert done.exit_code == 3
    assert "leave --solvers out" in " ".join(done.output.split())
