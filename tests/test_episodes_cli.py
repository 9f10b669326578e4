"""The command ``episodes``: plans, reports and batches into a data set, and what bad input gets."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from planner.batch import plan_grasps
from planner.errors import TaskError
from planner.files import write_json, write_plan
from planner.hands.hand import Hand
from planner.search.grasp import plan_grasp
from planner.task import GraspTask
from sim.cli import app
from sim.datasets.episodes.sources import Trials
from sim.scene.physics import PhysicsOptions
from sim.trial import simulate

pytestmark = pytest.mark.usefixtures("coarse_steps")

pa = pytest.importorskip("pyarrow")
pytest.importorskip("pyarrow.parquet")


def opposable(*words: str | Path) -> Any:
    return CliRunner().invoke(app, [str(word) for word in words], prog_name="opposable")


def flat(done: Any) -> str:
    return " ".join(done.output.split())


def rows_of(folder: Path) -> list[dict[str, Any]]:
    """The table of episodes of a LeRobot data set."""
    path = folder / "meta" / "episodes" / "chunk-000" / "file-000.parquet"
    rows: list[dict[str, Any]] = pa.parquet.read_table(path).to_pylist()
    return rows


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory, allegro: Hand) -> Path:
    """A folder with a plan, its report, a report without states, and a batch of two."""
    folder = tmp_path_factory.mktemp("inputs")
    (folder / "empty").mkdir()
    plan = plan_grasp(GraspTask.create(allegro, "box"))
    write_plan(plan, folder / "plan.json")
    report = simulate(plan)
    assert report.success
    write_json(report.to_dict(), folder / "report.json")
    write_json(report.to_dict(states=False), folder / "bare.json")
    task = GraspTask.create(allegro, "sphere")
    plan_grasps(allegro, [task], 2, seed=0, workers=1, out=folder / "grasps")
    return folder


@pytest.mark.slow
def test_plans_reports_and_batches_make_one_data_set(inputs: Path, tmp_path: Path) -> None:
    words = [inputs / "plan.json", inputs / "report.json", inputs / "grasps"]
    done = opposable("dataset", "episodes", *words, "-o", tmp_path / "set", "-n", "1", "--failed")
    assert done.exit_code == 0, done.output
    assert f"written to {tmp_path}/set: episodes: 3" in done.output
    ours = rows_of(tmp_path / "set")
    assert [e["source"] for e in ours] == [
        str(inputs / "plan.json"),
        str(inputs / "report.json"),
        f"{inputs / 'grasps'} row 0",
    ]
    assert [e["object"].split(":")[0] for e in ours] == ["box", "box", "sphere"]
    # the trial of the plan is the one that the report tells of
    first, second = (np.array(e["stats/observation.state/mean"]) for e in ours[:2])
    np.testing.assert_allclose(first, second, atol=6e-6)
    assert ours[0]["length"] == ours[1]["length"]


def test_json_tells_what_was_written(inputs: Path, tmp_path: Path) -> None:
    done = opposable(
        *(
            "dataset",
            "episodes",
            inputs / "report.json",
            "-o",
            tmp_path / "set",
            "--fps",
            "25",
            "--json",
        )
    )
    assert done.exit_code == 0, done.output
    told = json.loads(done.stdout)
    info = json.loads((tmp_path / "set" / "meta" / "info.json").read_text())
    assert told["format"] == "lerobot" and told["complete"] and info["fps"] == 25
    assert (told["episodes"], told["frames"]) == (info["total_episodes"], info["total_frames"])


@pytest.mark.slow
def test_failed_trials_are_named_and_kept_if_asked_for(inputs: Path, tmp_path: Path) -> None:
    words = ("dataset", "episodes", inputs / "plan.json", "--sim-mu", "0.05")
    done = opposable(*words, "-o", tmp_path / "set")
    assert done.exit_code == 3 and not (tmp_path / "set").exists()
    assert f"left out: {inputs / 'plan.json'}: the trial failed:" in flat(done)
    assert "there is no episode to write" in flat(done)
    done = opposable(*words, "-o", tmp_path / "set", "--failed")
    assert done.exit_code == 0, done.output
    (episode,) = rows_of(tmp_path / "set")
    assert not episode["success"] and episode["reason"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["missing.json"], "missing.json"),
        (["bare.json"], "has no recorded states"),
        (["grasps/manifest.json"], "not a plan or a report"),
        (["empty"], "holds neither a batch"),
        (["report.json", "--to", "hdf5"], "hdf5"),
        (["report.json", "--size", "big"], "'big' is no size of a film"),
        (["report.json", "--video", "--size", "100x100"], "multiples of 16"),
        (["report.json", "--fps", "30"], "rates that fit: 50, 25, 10, 5, 2, 1"),
        (["plan.json", "--fps", "30"], "fall between the time steps of 4 ms"),
        (["plan.json", "--controller", "none"], "none"),
        (["plan.json", "other.json"], "one data set holds one hand"),
    ],
)
def test_bad_input_is_named_and_leaves_nothing(
    inputs: Path, tmp_path: Path, words: list[str], said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("imageio_ffmpeg")
    report = json.loads((inputs / "report.json").read_text())
    (inputs / "other.json").write_text(json.dumps({**report, "hand": "shadow_hand"}))
    monkeypatch.chdir(inputs)
    done = opposable("dataset", "episodes", *words, "-o", tmp_path / "set")
    assert done.exit_code == 3, done.output
    assert said in flat(done)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("fps", "timestep", "period"),
    [
        (None, 0.002, 0.02),
        (50, 0.002, 0.02),
        (25, 0.002, 0.02),
        (20, 0.002, 0.01),
        (125, 0.002, 0.008),
        (30, 1 / 600, 1 / 60),
    ],
)
def test_trials_take_samples_where_frames_are(
    fps: int | None, timestep: float, period: float
) -> None:
    """At least 50 a second, since the verdict sees what is recorded."""
    trials = Trials(physics=PhysicsOptions(timestep=timestep), fps=fps)
    assert trials.record_every == pytest.approx(period)


def test_a_rate_between_time_steps_is_refused() -> None:
    with pytest.raises(TaskError, match=r"30 frames a second .* fit: 1, 2, 4, 5, 10, 20, 25, 50"):
        _ = Trials(physics=PhysicsOptions(timestep=0.002), fps=30).record_every
