"""``opposable drive``: outcomes, exit codes, errors, an own driver, Ctrl-C."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from planner.files import write_plan
from planner.search.grasp import plan_grasp
from planner.task import GraspTask
from sim.cli import app
from sim.real_hand import read_log
from sim.scene.carrier import Timeline

pytestmark = pytest.mark.usefixtures("virtual_time", "brief_trials")

RUN = CliRunner()

DRIVER = '''
"""A driver that a user might write: here a simulated hand, of which one reading is special."""

import os
import signal

from sim.real_hand import HandWrapper, RealClock, SimulatedHand
from sim.trial import Timeline, Trial


class Special(HandWrapper):
    reads = 0

    def read(self):
        self.reads += 1
        if self.reads == 20:
            self.special()
        return super().read()

    def special(self):
        pass


def plain(plan):
    return Special(SimulatedHand(Trial(plan), clock=RealClock()))


def pressed(plan):
    hand = plain(plan)
    hand.special = lambda: os.kill(os.getpid(), signal.SIGINT)
    return hand


def unplugged(plan):
    hand = plain(plan)

    def fails():
        raise OSError("no such device")

    hand.special = fails
    return hand


def nothing(plan):
    return 3
'''


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("drive")
    write_plan(plan_grasp(GraspTask.create("allegro_hand", "sphere")), out / "plan.json")
    (out / "driver.py").write_text(DRIVER, encoding="utf-8")
    return out


@pytest.fixture
def drive(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.chdir(folder)

    def run(*arguments: str) -> Any:
        return RUN.invoke(app, ["drive", "plan.json", *arguments], env={"COLUMNS": "100"})

    return run


@pytest.mark.slow
def test_a_simulated_hand_holds_and_its_log_replays(drive: Any, folder: Path) -> None:
    done = drive("--fast", "--log", "run.npz", "--json")
    assert done.exit_code == 0, done.output
    data = json.loads(done.stdout)
    assert data["loop"]["done"] and data["trial"]["success"]
    assert data["loop"]["rate_hz"] == 100.0
    ticks = data["loop"]["ticks"]
    assert len(read_log(folder / "run.npz")) == ticks > 0.8 * 100.0 * Timeline().duration
    again = drive("--replay", "run.npz")
    assert again.exit_code == 0, again.output
    assert "largest difference" in again.output
    compared = json.loads(drive("--replay", "run.npz", "--json").stdout)["comparison"]
    assert compared["compared"] == data["loop"]["ticks"] and compared["largest"] < 1e-9


@pytest.mark.slow
def test_a_log_is_replayed_with_its_own_plan_and_rate(drive: Any, folder: Path) -> None:
    assert drive("--fast", "--rate", "50", "--log", "slow.npz").exit_code == 0
    assert drive("--replay", "slow.npz").exit_code == 0, "the rate is that of the log"
    done = drive("--replay", "slow.npz", "--rate", "100")
    assert done.exit_code == 3
    assert "100 Hz is asked for; give 50 Hz" in " ".join(done.stderr.split())
    write_plan(plan_grasp(GraspTask.create("allegro_hand", "sphere"), seed=1), folder / "b.json")
    done = RUN.invoke(app, ["drive", "b.json", "--replay", "slow.npz"])
    assert done.exit_code == 3
    assert "the log is of another grasp of sphere" in " ".join(done.stderr.split())


def test_a_movement_is_told_what_takes_it(folder: Path) -> None:
    (folder / "m.json").write_text('{"format": "opposable-manipulation", "version": 1}')
    for command in ("drive", "simulate", "forces"):
        done = RUN.invoke(app, [command, str(folder / "m.json")])
        said = " ".join(done.stderr.split())
        assert done.exit_code == 3 and "manipulate --plan" in said and "ros2-trajectory" in said


def test_a_dry_run_moves_nothing(drive: Any) -> None:
    done = drive("--fast", "--dry-run", "--json")
    data = json.loads(done.stdout)
    assert data["loop"]["reason"] == "too few fingers touch"  # the fingers stay where they are
    assert "trial" not in data and done.exit_code == 1


@pytest.mark.slow
def test_joints_are_checked_one_by_one(drive: Any) -> None:
    done = drive("--fast", "--check-joints", "--json")
    assert done.exit_code == 0, done.output
    data = json.loads(done.stdout)
    assert len(data["joints"]) == 16 and not any(row["fault"] for row in data["joints"])
    assert "A_thumb_3" in drive("--fast", "--check-joints").output


def test_ctrl_c_is_an_emergency_stop(drive: Any, folder: Path) -> None:
    done = drive("--hand-interface", "driver.py:pressed", "--log", "cut.npz", "--json")
    assert done.exit_code == 130
    data = json.loads(done.stdout)["loop"]
    assert data["reason"] == "interrupted" and data["on_stop"] == "torque off"
    assert data["written"] == len(read_log(folder / "cut.npz")) <= 20


def test_a_hand_that_fails_is_told(drive: Any) -> None:
    done = drive("--hand-interface", "driver.py:unplugged", "--on-stop", "hold")
    assert done.exit_code == 1
    assert "interface failed: reading: no such device; then: hold" in " ".join(done.output.split())


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--hand-interface", "driver.py"], "give module:factory or file.py:factory"),
        (["--hand-interface", "none.py:make"], "none.py does not exist"),
        (["--hand-interface", "no_such_module:make"], "No module named 'no_such_module'"),
        (["--hand-interface", "driver.py:plan"], "Did you mean 'plain'?"),
        (["--hand-interface", "driver.py:nothing"], "made a int without joint_names"),
        (["--hand-interface", "driver.py:plain", "--replay", "x"], "exclude each other"),
        (["--replay", "x.npz", "--fast"], "exclude each other"),
        (["--replay", "x.npz"], "x.npz does not exist"),
        (["--replay", "x.npz", "--check-joints"], "a log has none"),
        (["--rate", "0"], "the rate is 0.0"),
        (["--rate", "5000", "--fast"], "at 250 Hz at most"),  # steps of 4 ms
        (["--assume", "luck"], "no planned value that may stand in"),
        (["--max-rate", "-1"], "give a number > 0 in rad/s"),
        (["--on-stop", "panic"], "There is: hold, torque-off"),
        (["--log", "no/run.npz"], "there is no folder"),
        (["--log", "run.txt"], "run.txt is no name of a log; let it end with .npz"),
        (["--log", "plan.json"], "plan.json would be written over; give another name"),
        (["--controller", "x"], "no controller is called"),
    ],
)
def test_bad_input_is_refused_with_a_remedy(drive: Any, arguments: list[str], words: str) -> None:
    done = drive(*arguments)
    assert done.exit_code == 3
    assert words in " ".join(done.stderr.split())
    assert len(done.stderr.splitlines()) <= 3
