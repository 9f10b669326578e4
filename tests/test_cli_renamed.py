"""Old names of commands: hidden, the same as the new line, and told in one sentence."""

from __future__ import annotations

import json
import shlex
from pathlib import Path

import pytest
from typer.testing import CliRunner

import sim.cli.listing as listing
from planner.files import read_motion
from sim.cli import app
from sim.cli.listing import RENAMED, word_of_today

RUN = CliRunner()

LINES = {
    "simulate plan.json -o r.json": "test plan.json -o r.json",
    "creep plan.json --physics menagerie": "test plan.json --physics menagerie --protocol creep",
    "demo --out runs/demo": "manipulate --demo --out runs/demo",
    "plan-motion h o --angle 30": "manipulate h o --rotate z:30 --mu 0.5 --plan-only",
    "plan-motion h o": "manipulate h o --rotate z:max --mu 0.5 --plan-only",
    "plan-gait h o --axis 0,1,0 --angle=20 --mu=0.4": (
        "manipulate h o --mu=0.4 --rotate 0,1,0:20 --plan-only --gait"
    ),
    "forces plan.json --gaps": "analyse plan.json --gaps --forces",
    "extract grasps 0 -o first.json": "batch grasps --extract 0 -o first.json",
    "extract --out first.json grasps 3": "batch grasps --extract 3 -o first.json",
    "schema": "export --schema plan",
    "schema report": "export --schema report",
    "audit plan.json --approach": "refine plan.json --approach --judge-only",
    "inspect shadow_hand --json": "hands shadow_hand --json",
    "check-hand hand.toml": "hands hand.toml --check",
    "describe my.xml -o hand.toml": "hands my.xml -o hand.toml --describe",
    "states allegro_hand box -n 5": "dataset states allegro_hand box -n 5",
    "episodes plan.json": "dataset episodes plan.json",
}


@pytest.mark.parametrize(("old", "new"), LINES.items())
def test_an_old_line_is_a_new_one(old: str, new: str) -> None:
    name, *words = shlex.split(old)
    assert shlex.join(RENAMED[name].line(words)) == new


def test_every_old_name_is_among_them() -> None:
    assert {old.split()[0] for old in LINES} == set(RENAMED)


def test_an_old_name_does_the_same_and_says_the_new_line() -> None:
    old = RUN.invoke(app, ["inspect", "allegro_hand", "--json"])
    new = RUN.invoke(app, ["hands", "allegro_hand", "--json"])
    assert old.exit_code == new.exit_code == 0
    assert json.loads(old.stdout) == json.loads(new.stdout)
    assert old.stderr.count("\n") == 1
    assert "opposable hands allegro_hand --json" in old.stderr
    assert new.stderr == ""


def test_old_options_do_the_same_and_say_the_new_line(tmp_path: Path) -> None:
    said = []
    for words in (["--reality=moon"], ["--error-model=moon"]):
        done = RUN.invoke(app, ["run", "allegro_hand", "box", *words, "--out", str(tmp_path)])
        assert done.exit_code == 3
        said.append(done.stderr)
    assert "--reality=moon" in said[0].split("next version")[0]
    assert "opposable run allegro_hand box --error-model=moon" in said[0]
    assert said[0].endswith(said[1]) and "no error model is called 'moon'" in said[1]
    old = ["test", "none.json", "--reality", "lab", "--reality-seed", "3"]
    assert [word_of_today(w) for w in old][2::2] == ["--error-model", "--error-seed"]


def test_the_words_of_an_old_movement_mean_the_same(tmp_path: Path) -> None:
    file = tmp_path / "motion.json"
    words = ["plan-motion", "allegro_hand", "cylinder:0.03x0.1", "--axis", "0,0,-1"]
    done = RUN.invoke(app, [*words, "--angle", "25", "-o", str(file)])
    assert done.exit_code == 0, done.output
    motion = read_motion(file)
    assert motion.path.axis == pytest.approx((0.0, 0.0, -1.0))
    assert motion.path.angle == pytest.approx(0.4363, abs=1e-4)
    assert motion.grasp.task.mu == 0.5


def test_a_wheel_says_where_measurements_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(listing, "CHECKOUT", tmp_path)
    done = RUN.invoke(app, ["bench", "grasps"])
    assert done.exit_code == 3
    assert "python -m benchmarks NAME" in " ".join(done.stderr.split())


def test_a_checkout_measures_by_the_old_name_too() -> None:
    done = RUN.invoke(app, ["bench", "grasps", "--help"])
    assert done.exit_code == 0
    assert "python -m benchmarks grasps" in done.stderr
