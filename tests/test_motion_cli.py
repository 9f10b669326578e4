"""``opposable plan-motion`` and ``plan-gait``, and what is wrong with what they are given."""

from __future__ import annotations

import inspect
import json
from collections.abc import Callable
from pathlib import Path

import pytest
from sim.cli.manipulation import manipulate
from sim.cli.motion import plan_gait, plan_motion
from typer.testing import CliRunner

import planner.motion.gait.search
import planner.motion.manipulation.single_stroke
import planner.motion.search
from benchmarks.conditions import BELIEVED_MU
from planner.files import read_motion
from planner.task import DEFAULT_MU
from sim.cli import app

RUN = CliRunner()
THREE = ["plan-motion", "allegro_hand", "cylinder:0.03x0.1", "--fingers", "thumb,index,middle"]


def test_a_motion_is_planned_printed_and_written(tmp_path: Path) -> None:
    path = tmp_path / "motion.json"
    done = RUN.invoke(app, [*THREE, "--angle", "-40", "--out", str(path)])
    assert done.exit_code == 0, done.output
    assert "-40.0 degrees about (0, 0, 1)" in done.output
    assert read_motion(path).path.angle == pytest.approx(-0.698132, abs=1e-6)


def test_a_translation_as_json(tmp_path: Path) -> None:
    arguments = ["--angle", "0", "--shift", "0,0,0.02", "--path-tolerance", "0.01", "--json"]
    arguments += ["-o", str(tmp_path / "m.json")]
    done = RUN.invoke(app, [*THREE, *arguments])
    assert done.exit_code == 0, done.output
    data = json.loads(done.stdout)
    first, last = (data["knots"][k]["T_world_object"]["position_m"] for k in (0, -1))
    assert last[2] - first[2] == pytest.approx(0.02, abs=0.0102)  # and the path tolerance


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--axis", "up"], "--axis 'up' holds something else than numbers"),
        (["--axis", "0,1"], "--axis '0,1' has 2 numbers; give three"),
        (["--angle", "400"], "at most a half turn"),
        (["--angle", "90", "--path-tolerance", "-1"], "path_tolerance is -1"),
    ],
)
def test_bad_input_is_told(tmp_path: Path, arguments: list[str], words: str) -> None:
    done = RUN.invoke(app, [*THREE, *arguments, "-o", str(tmp_path / "m.json")])
    assert done.exit_code == 3
    assert words in done.output
    assert not list(tmp_path.iterdir())


def test_what_is_out_of_reach_ends_with_four(tmp_path: Path) -> None:
    arguments = ["--angle", "175", "--max-attempts", "1", "-o", str(tmp_path / "m.json")]
    done = RUN.invoke(app, [*THREE, *arguments])
    assert done.exit_code == 4
    assert "no motion of" in done.output


def test_a_regrasp_that_cannot_be_is_told(tmp_path: Path) -> None:
    arguments = [*THREE[1:], "--angle", "360", "-o", str(tmp_path / "gait.json")]
    done = RUN.invoke(app, ["plan-gait", *arguments])
    assert done.exit_code == 3
    assert "lifting one of 3 fingers" in " ".join(done.output.split())


def test_a_gait_of_one_stroke_is_written(tmp_path: Path) -> None:
    path = tmp_path / "gait.json"
    arguments = [
        "allegro_hand",
        "cylinder:0.03x0.1",
        "--angle",
        "20",
        "-o",
        str(path),
    ]
    done = RUN.invoke(app, ["plan-gait", *arguments])
    assert done.exit_code == 0, done.output
    assert "1 stroke of 20.0 degrees" in done.output
    assert json.loads(path.read_text())["format"] == "opposable-gait"


@pytest.mark.parametrize(
    ("command", "mu", "attempts"),
    [
        (plan_motion, DEFAULT_MU, planner.motion.search.MAX_ATTEMPTS),
        (plan_gait, DEFAULT_MU, planner.motion.gait.search.MAX_ATTEMPTS),
        (manipulate, BELIEVED_MU, planner.motion.manipulation.single_stroke.MAX_ATTEMPTS),
    ],
)
def test_commands_believe_and_spend_what_the_library_does(
    command: Callable[..., None], mu: float, attempts: int
) -> None:
    defaults = inspect.signature(command).parameters
    assert defaults["mu"].default == pytest.approx(mu)
    assert defaults["max_attempts"].default == attempts


def test_a_motion_takes_the_whole_task(tmp_path: Path) -> None:
    """On a stand, on a table that is not at z = 0, soft contacts: all of it stands in the file."""
    path = tmp_path / "m.json"
    asked = ["--table", "0.2", "--stand", "0.05", "--mu-torsion", "0.005", "--density", "500"]
    done = RUN.invoke(app, [*THREE, "--angle", "10", *asked, "-o", str(path)])
    assert done.exit_code == 0, done.output
    task = read_motion(path).grasp.task
    assert task.table_height == pytest.approx(0.2)
    assert task.obstacles  # the stand
    # the cylinder stands on its foot, 5 cm above the table
    assert task.T_world_object.translation[2] == pytest.approx(0.2 + 0.05 + 0.05, abs=1e-3)
    assert task.contact_model == "soft"
    assert task.object.mass == pytest.approx(500 * 3.14159265 * 0.03**2 * 0.1, rel=1e-4)
    refused = RUN.invoke(
        app, ["plan-gait", *THREE[1:], "--angle", "20", "--pose", "7", "-o", str(path)]
    )
    assert refused.exit_code == 3
    assert "pose" in refused.output
