"""Commands write the page of what they did, and say in one line where it is."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from planner.files import read_manipulation, write_plan
from planner.search.grasp import plan_grasp
from planner.task import GraspTask
from sim.cli import app
from sim.manipulation import read_manipulation_report
from sim.report_file import read_report

pytestmark = pytest.mark.usefixtures("brief_trials")


def opposable(*words: str | Path) -> Any:
    return CliRunner().invoke(app, [str(word) for word in words], prog_name="opposable")


@pytest.fixture(scope="module")
def planned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("plan") / "plan.json"
    write_plan(plan_grasp(GraspTask.create("allegro_hand", "box")), path)
    return path


def line_of(output: str, begin: str) -> str:
    """The line that begins so; there must be one."""
    (line,) = [line for line in output.splitlines() if line.startswith(begin)]
    return line


@pytest.mark.slow
def test_run_writes_a_page_and_says_where(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    done = opposable("run", "allegro_hand", "box", "--sim-mu", "0.7", "--out", folder)
    assert done.exit_code == 0, done.output
    where = line_of(done.output, "open in a browser")
    assert where.startswith(f"open in a browser: {folder}/report.html ")
    assert "plan:" not in done.output
    report = read_report(folder / "report.html")
    assert report == read_report(folder / "report.json")
    assert report.command == f"opposable run allegro_hand box --out {folder} --sim-mu 0.7"


def test_simulate_writes_the_page_beside_the_report(planned: Path, tmp_path: Path) -> None:
    done = opposable("test", planned, "-o", tmp_path / "trial.json")
    assert f"open in a browser: {tmp_path}/trial.html" in done.output
    assert read_report(tmp_path / "trial.html") == read_report(tmp_path / "trial.json")
    assert {file.name for file in tmp_path.iterdir()} == {"trial.json", "trial.html"}


def test_simulate_writes_a_page_alone_if_its_name_says_so(planned: Path, tmp_path: Path) -> None:
    done = opposable("test", planned, "-o", tmp_path / "trial.html", "--json")
    assert {file.name for file in tmp_path.iterdir()} == {"trial.html"}
    told = json.loads(done.stdout)
    assert told == read_report(tmp_path / "trial.html").model_dump(mode="json")
    assert told["recording"]["joint_names"][0] == told["plan"]["grasp"]["joint_names"][0]


def test_simulate_without_a_file_writes_nothing(planned: Path, tmp_path: Path) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path)
        done = opposable("test", planned)
    assert "browser" not in done.output and not list(tmp_path.iterdir())


def test_a_page_is_not_written_where_it_cannot_be(planned: Path, tmp_path: Path) -> None:
    done = opposable("test", planned, "-o", tmp_path / "missing" / "trial.html")
    assert done.exit_code == 3 and "there is no folder" in " ".join(done.output.split())


def test_manipulate_writes_its_plan_a_report_and_a_page(tmp_path: Path) -> None:
    words = ("manipulate", "allegro_hand", "cylinder", "--rotate", "20", "--out", tmp_path / "m")
    done = opposable(*words)
    assert done.exit_code == 0, done.output
    assert {file.name for file in (tmp_path / "m").iterdir()} >= {"trajectory.csv"}
    planned = read_manipulation(tmp_path / "m" / "manipulation.json")
    assert math.degrees(planned.angle) == pytest.approx(20.0)
    page = tmp_path / "m" / "report.html"
    assert f"open in a browser: {page}" in done.output
    report = read_manipulation_report(page)
    assert report == read_manipulation_report(tmp_path / "m" / "report.json")
    assert report.success_with_closure and report.asked_deg == pytest.approx(20.0)
    assert report.plan is not None and report.plan["format"] == "opposable-movement"
    assert report.command.startswith("opposable manipulate allegro_hand cylinder")
    assert page.stat().st_size < 3e6
