"""Objects too low for fingertips: the pose or the stand that is advised, and that it does."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
from typer.testing import CliRunner

from planner.failure import Failure
from planner.plan import GraspPlan
from planner.search.attempt import Attempt
from planner.search.grasp import _one_cause
from planner.synthesis.options import SynthesisOptions
from planner.synthesis.terms.registry import TERMS
from planner.task import GraspTask
from sim.cli import app
from sim.cli.advice import ATTEMPTS, LOW, advice_for_low
from sim.cli.search import PlanOptions

RUN = CliRunner()


FEW = 3
"""Attempts where none succeeds, however many there are."""


def plan(line: str, folder: Path, attempts: int = ATTEMPTS) -> tuple[int, str]:
    """Exit code of ``plan`` with the Allegro-type hand, and what it says."""
    arguments = ["plan", "allegro_hand", *shlex.split(line), "-o", str(folder / "plan.json")]
    done = RUN.invoke(app, [*arguments, "--max-attempts", str(attempts)])
    return done.exit_code, " ".join(done.stderr.split())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("line", "advice"),
    [
        ("box:0.1x0.06x0.012", "it lies 12 mm high"),
        ("cylinder:0.04x0.015", "it lies 15 mm high"),
        ("lbracket:0.09x0.08x0.012x0.012", "it lies 12 mm high"),
    ],
)
def test_a_low_object_is_told_what_would_do_and_it_does(
    line: str, advice: str, tmp_path: Path
) -> None:
    code, said = plan(line, tmp_path)
    assert code == 4
    assert re.search(advice, said)
    assert "a fingertip of allegro_hand is 24 mm thick" in said
    assert "term" not in said
    found = re.search(r"--(pose \d+|stand [0-9.]+)", said)
    assert found is not None
    assert plan(f"{line} {found[0]}", tmp_path) == (0, "")


@pytest.mark.slow
def test_what_is_to_be_turned_is_told_its_stand() -> None:
    line = ["manipulate", "allegro_hand", "cylinder:0.04x0.015", "--max-attempts", "4"]
    done = RUN.invoke(app, line)
    assert done.exit_code == 4
    said = " ".join(done.stderr.split())
    assert "it lies 15 mm high on the table" in said
    assert said.endswith("on a stand of 30 mm a grasp was found: --stand 0.03")


def test_a_pose_comes_before_a_stand_and_says_how_high_it_is() -> None:
    task = GraspTask.create("allegro_hand", "box:0.1x0.06x0.012")
    advice = advice_for_low(task, pose=0, options=SynthesisOptions())
    assert advice is not None
    number = int(advice.rsplit(" ", 1)[1])
    turn = task.object.shape.resting_poses()[number].rotation
    height = task.object.shape.support(turn[2]) + task.object.shape.support(-turn[2])
    assert f"pose {number} stands {1e3 * height:.0f} mm high" in advice
    assert height > 0.05


def test_the_place_and_the_table_are_kept() -> None:
    given = PlanOptions(at="0.3,0.1", table="0.5", max_attempts=12)
    task = given.task("allegro_hand", "box:0.1x0.06x0.012")
    seen: list[str] = []
    advice = advice_for_low(
        task, pose=0, options=SynthesisOptions(), progress=lambda a: seen.append(str(a.failure))
    )
    assert advice is not None
    assert seen[-1] == "None"  # found where it stands, on that table
    assert not any("table" in text for text in seen)


@pytest.mark.slow
def test_nothing_is_advised_where_height_is_not_what_is_missing(tmp_path: Path) -> None:
    code, said = plan("box --mass 15", tmp_path, FEW)
    assert code == 4
    assert "--pose" not in said
    thick = 2 * max(f.pad.radius for f in GraspTask.create("allegro_hand", "box").fingers)
    assert LOW * thick < 0.08


@pytest.mark.slow
def test_what_nothing_helps_is_told_as_before(tmp_path: Path) -> None:
    code, said = plan("box:0.1x0.06x0.012 --mass 15", tmp_path, FEW)
    assert code == 4
    assert "--pose" not in said
    assert "--stand" not in said
    assert f"in {FEW} attempts: {FEW} x" in said


def test_an_object_whose_pose_was_given_is_not_stood_otherwise(tmp_path: Path) -> None:
    code, said = plan("box:0.1x0.06x0.012 --at 0,0,0.006,0,0,0", tmp_path, FEW)
    assert code == 4
    assert "--pose" not in said


# other failures


@pytest.mark.slow
def test_a_cause_is_told_in_words_with_the_nearest_size_that_does(tmp_path: Path) -> None:
    line = ["plan", "shadow_hand", "box:0.11x0.11x0.11", "--max-attempts", "8"]
    done = RUN.invoke(app, [*line, "-o", str(tmp_path / "plan.json")])
    assert done.exit_code == 4
    said = " ".join(done.stderr.split())
    assert "8 x not solved, term level" in said
    assert f"That is: {TERMS['level'].lacking}. " in said
    found = re.search(r"In (\S+) times the size a grasp was found: box:([0-9.]+)x", said)
    assert found is not None
    assert float(found[2]) == pytest.approx(0.11 * float(found[1]))
    line = ["plan", "shadow_hand", f"box:{found[2]}x{found[2]}x{found[2]}"]
    line += ["--max-attempts", "12", "-o", str(tmp_path / "plan.json")]
    assert RUN.invoke(app, line).exit_code == 0


@pytest.mark.parametrize(("balance", "told"), [(8, True), (7, False)])
def test_several_causes_are_not_told_as_one(balance: int, told: bool) -> None:
    kinds = ["unsolved_balance"] * balance + ["unsolved_touch", "edge", "off_pad"][balance - 10 :]
    made = [
        Attempt[GraspPlan](index=i, plan=None, failure=Failure(kind=k, text=k), cpu_s=0.0)
        for i, k in enumerate(kinds)
    ]
    assert len(made) == 10
    assert bool(_one_cause(made)) == told


def test_every_term_says_what_it_means_if_nothing_satisfies_it() -> None:
    for term in TERMS.values():
        assert term.lacking or term.role.is_cost, term.name
