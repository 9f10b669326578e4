"""``opposable manipulate --plan-only``, and what is wrong with what it is given."""

from __future__ import annotations

import inspect
import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

import planner.motion.single_stroke
from benchmarks.conditions import BELIEVED_MU
from planner.files import read_motion
from sim.cli import app
from sim.cli.manipulate import MAX_ATTEMPTS, MU, manipulate

RUN = CliRunner()
OBJECT = ["allegro_hand", "cylinder:0.03x0.1"]
THREE = ["manipulate", *OBJECT, "--fingers", "thumb,index,middle", "--plan-only"]


def test_a_motion_is_planned_printed_and_written(tmp_path: Path) -> None:
    path = tmp_path / "motion.json"
    done = RUN.invoke(app, [*THREE, "--rotate", "-40", "--out", str(path)])
    assert done.exit_code == 0, done.output
    assert "-40.0 degrees about (0, 0, 1)" in done.output
    assert read_motion(path).path.angle == pytest.approx(-0.698132, abs=1e-6)


def test_a_translation_as_json(tmp_path: Path) -> None:
    arguments = ["--shift", "0,0,0.02", "--json"]
    arguments += ["-o", str(tmp_path / "m.json")]
    done = RUN.invoke(app, [*THREE, *arguments])
    assert done.exit_code == 0, done.output
    data = json.loads(done.stdout)
    first, last = (data["knots"][k]["T_world_object"]["position_m"] for k in (0, -1))
    assert last[2] - first[2] == pytest.approx(0.02, abs=0.0202)  # and the path tolerance


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--rotate", "up:30"], "--rotate 'up:30' names no axis"),
        (["--rotate", "0,1:30"], "--rotate '0,1' has 2 numbers; give three"),
        (["--rotate", "400"], "at most a half turn"),
        (["--controller", "impedance"], "--plan-only executes nothing; leave --controller out"),
        (["--gait", "--rotate", "max"], "--rotate max and --best-of are for one grasp"),
    ],
)
def test_bad_input_is_told(tmp_path: Path, arguments: list[str], words: str) -> None:
    done = RUN.invoke(app, [*THREE, *arguments, "-o", str(tmp_path / "m.json")])
    assert done.exit_code == 3
    assert words in done.output
    assert not list(tmp_path.iterdir())


def test_what_is_out_of_reach_ends_with_four(tmp_path: Path) -> None:
    arguments = ["--rotate", "175", "--max-attempts", "1", "-o", str(tmp_path / "m.json")]
    done = RUN.invoke(app, [*THREE, *arguments])
    assert done.exit_code == 4
    assert "no motion of" in done.output


def test_a_regrasp_that_cannot_be_is_told(tmp_path: Path) -> None:
    arguments = ["--gait", "--rotate", "360", "-o", str(tmp_path / "gait.json")]
    done = RUN.invoke(app, [*THREE, *arguments])
    assert done.exit_code == 3
    assert "lifting one of 3 fingers" in " ".join(done.output.split())


def test_a_gait_of_one_stroke_is_written(tmp_path: Path) -> None:
    path = tmp_path / "gait.json"
    # by its old name, which does the same
    done = RUN.invoke(app, ["plan-gait", *OBJECT, "--angle", "20", "-o", str(path)])
    assert done.exit_code == 0, done.output
    assert "cylinder:0.03x0.1: 20.0 degrees about" in " ".join(done.output.split())
    assert json.loads(path.read_text())["format"] == "opposable-movement"


def test_the_command_believes_and_spends_what_the_library_does() -> None:
    defaults = inspect.signature(manipulate).parameters
    library = planner.motion.single_stroke.MAX_ATTEMPTS
    assert defaults["mu"].default == MU == pytest.approx(BELIEVED_MU)
    assert defaults["max_attempts"].default == MAX_ATTEMPTS == library


def test_a_manipulation_refuses_what_only_a_plan_takes() -> None:
    done = RUN.invoke(app, ["manipulate", *OBJECT, "--table", "0.1"])
    assert done.exit_code == 3
    assert "leave --table out" in " ".join(done.output.split())
    done = RUN.invoke(app, ["manipulate", *OBJECT, "--rotate", "max"])
    assert done.exit_code == 3
    assert "--rotate max is for --plan-only" in " ".join(done.output.split())


@pytest.mark.slow
def test_a_motion_takes_the_whole_task(tmp_path: Path) -> None:
    """On a stand, on a table that is not at z = 0, soft contacts: all of it stands in the file."""
    path = tmp_path / "m.json"
    asked = ["--table", "0.2", "--stand", "0.05", "--mu-torsion", "0.005", "--density", "500"]
    done = RUN.invoke(app, [*THREE, "--rotate", "10", *asked, "-o", str(path)])
    assert done.exit_code == 0, done.output
    task = read_motion(path).grasp.task
    assert task.table_height == pytest.approx(0.2)
    assert task.obstacles  # the stand
    # the cylinder stands on its foot, 5 cm above the table
    assert task.T_world_object.translation[2] == pytest.approx(0.2 + 0.05 + 0.05, abs=1e-3)
    assert task.contact_model == "soft"
    assert task.object.mass == pytest.approx(500 * 3.14159265 * 0.03**2 * 0.1, rel=1e-4)
    refused = RUN.invoke(app, [*THREE, "--gait", "--pose", "7", "-o", str(path)])
    assert refused.exit_code == 3
    assert "pose" in refused.output
