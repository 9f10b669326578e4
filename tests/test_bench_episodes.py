"""The command that has LeRobot read our data sets: its plumbing, on a stand-in for LeRobot."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import ReportOf
from typer.testing import CliRunner

from benchmarks.episodes import agrees, check, episodes_table
from sim.cli import app
from sim.episodes import episodes_of, write_lerobot
from sim.episodes.lerobot import VIDEO_KEY
from sim.report import TrialReport

pytestmark = pytest.mark.slow

pytest.importorskip("pyarrow")
pytest.importorskip("imageio_ffmpeg")

STAND_IN = '''#!{python}
"""Reads a data set with pyarrow and ffmpeg; takes what LeRobot's Python takes: -I SCRIPT ..."""
import json, subprocess, sys
from pathlib import Path
import imageio_ffmpeg
import numpy as np
import pyarrow.parquet as pq

folder, out, *frames = sys.argv[3:]
folder, frames = Path(folder), [int(f) for f in frames]
info = json.loads((folder / "meta/info.json").read_text())
stats = json.loads((folder / "meta/stats.json").read_text())
tasks = pq.read_table(folder / "meta/tasks.parquet")["task"].to_pylist()
table = pq.read_table(folder / "data/chunk-000/file-000.parquet")
film = "observation.images.front"
found = {{}}
for key in table.column_names:
    column = np.array(table[key].to_pylist(), dtype=info["features"][key]["dtype"])
    found["column/" + key], found["item/" + key] = column, column[frames]
    for name, values in stats[key].items():
        found[f"theirs/{{key}}/{{name}}"] = found[f"stored/{{key}}/{{name}}"] = np.array(values)
found["item/task"] = np.array([tasks[k] for k in found["item/task_index"]])
height, width, _ = info["features"][film]["shape"]
pictures = []
for k, i in zip(found["item/episode_index"], found["item/frame_index"]):
    path = folder / f"videos/{{film}}/chunk-000/file-{{k:03d}}.mp4"
    words = ["-loglevel", "error", "-i", str(path), "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    words = [imageio_ffmpeg.get_ffmpeg_exe(), *words]
    done = subprocess.run(words, capture_output=True, check=True)
    whole = np.frombuffer(done.stdout, np.uint8).reshape(-1, height, width, 3)
    pictures.append(whole[i].transpose(2, 0, 1) / 255)
found["item/" + film] = np.array(pictures)
np.savez(out, **found)
told = {{"frames": len(table), "episodes": info["total_episodes"], "fps": info["fps"]}}
print(json.dumps({{**told, "lerobot": "0", "torch": "0"}}))
'''


@pytest.fixture(scope="module")
def python(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What stands for the Python of LeRobot's environment."""
    path = tmp_path_factory.mktemp("environment") / "python"
    path.write_text(STAND_IN.format(python=sys.executable))
    path.chmod(0o755)
    return path


@pytest.fixture(scope="module")
def reports(report_of: ReportOf) -> list[TrialReport]:
    return [report_of("allegro_hand", thing) for thing in ("box", "sphere")]


@pytest.fixture(scope="module")
def read(
    python: Path,
    reports: list[TrialReport],
    can_draw: bool,
    tmp_path_factory: pytest.TempPathFactory,
) -> tuple[Path, dict[str, Any]]:
    """A data set, and what the stand-in reads of it."""
    if not can_draw:
        pytest.skip("this machine draws nothing")
    folder = tmp_path_factory.mktemp("data")
    home = folder / "set"
    written = write_lerobot(reports, home, video=True, size=(64, 48), failed=True)
    return home, check._read(python, home, written.frames, folder / "read.npz")[1]


def test_what_was_written_agrees(
    read: tuple[Path, dict[str, Any]], reports: list[TrialReport]
) -> None:
    home, found = read
    episodes = [episode for report in reports for episode in episodes_of(report)]
    assert 0 < check._columns_off(episodes, found) <= check.MOST_OFF
    assert check._indexes_right(episodes, found, 50)
    assert check._film_off(home, found) <= check.MOST_LEVELS
    assert check._statistics_off(found) == check._quantiles_off(found) == 0.0


def test_faults_are_noticed(read: tuple[Path, dict[str, Any]], reports: list[TrialReport]) -> None:
    home, found = read
    episodes = [episode for report in reports for episode in episodes_of(report)]

    def spoiled(key: str, change: Any) -> dict[str, Any]:
        return {**found, key: change(found[key])}

    late = spoiled("column/action", lambda rows: np.roll(rows, 1, axis=0))
    assert check._columns_off(episodes, late) > check.MOST_OFF
    assert check._columns_off(episodes[::-1], found) > check.MOST_OFF
    for key in ("column/index", "column/task_index", "column/timestamp", "item/observation.state"):
        assert not check._indexes_right(episodes, spoiled(key, lambda v: v + 1), 50), key
    assert not check._indexes_right(episodes, found, 25)
    assert not check._indexes_right(episodes, spoiled("item/task", lambda v: v[::-1]), 50)
    pictures = f"item/{VIDEO_KEY}"
    moved = spoiled(pictures, lambda v: np.roll(v, 1, axis=0))  # frames of other rows
    assert check._film_off(home, moved) > check.MOST_LEVELS
    wrong = spoiled("stored/action/mean", lambda v: v + 0.01)
    assert check._statistics_off(wrong) > check.STATISTICS_OFF
    wrong = spoiled("stored/action/q50", lambda v: v + 0.01)
    assert check._quantiles_off(wrong) > check.BINS_OFF


@pytest.mark.usefixtures("brief_trials")
def test_the_command_tells_whether_all_agrees(python: Path, can_draw: bool, tmp_path: Path) -> None:
    if not can_draw:
        pytest.skip("this machine draws nothing")
    words = ["bench", "episodes", "allegro_hand", "--objects", "box", "--lerobot", str(python)]
    done = CliRunner().invoke(app, [*words, "--out", str(tmp_path / "result.json")])
    assert done.exit_code == 0, done.output
    result = json.loads((tmp_path / "result.json").read_text())
    assert agrees(result) and result["format"] == "opposable-episodes-check"
    (row,) = result["rows"]
    assert row["episodes"] == row["written_episodes"] == 1 and row["film_kilobytes"] > 1
    for key, value in (("indexes_right", False), ("frames", 1), ("largest_difference", 1e-3)):
        assert not agrees({**result, "rows": [{**row, key: value}]}), key
    lost = {"hand": "allegro_hand", "error": "its process died"}
    assert not agrees({**result, "rows": [lost]})
    assert episodes_table({**result, "rows": [row, lost]}).row_count == 2


def test_a_missing_environment_is_named() -> None:
    words = ["bench", "episodes", "allegro_hand", "--lerobot", "no/python"]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 3
    assert "no/python" in done.output and "lerobot[dataset]" in " ".join(done.output.split())
