"""LeRobot itself reads our data sets of episodes: what it reads is what was recorded.

With the Python of an environment that has ``lerobot[dataset]`` in ``OPPOSABLE_LEROBOT``; without,
a stand-in reads with pyarrow and ffmpeg. Every column and index is compared with the recordings,
frames of the films with the pictures that another decoder has at their place, and the stored
statistics with those that LeRobot's own functions compute.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import PlanOf

from sim.datasets.episodes import Episode, episodes_of, write_lerobot
from sim.datasets.episodes.lerobot import VIDEO_KEY, frames_of
from sim.report import TrialReport
from sim.scene.carrier import Timeline
from sim.trial import simulate

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("coarse_steps")]

pytest.importorskip("pyarrow")
pytest.importorskip("imageio_ffmpeg")

LAUNCH = Path(__file__).with_name("lerobot_reader.py")
"""Script for the environment's Python."""

LOOKED_AT = 12
"""Frames of a data set that are decoded."""

MOST_OFF = 1e-6
"""Largest difference (m, rad, N, relative for larger numbers) of what is read from what was
recorded: rounding to 32 bits is 6e-8 of a number."""

MOST_LEVELS = 1.0
"""Largest mean difference (levels of 255) of two decoders: they convert colours differently."""

STATISTICS_OFF = 1e-5
"""Largest difference of least, greatest and mean value as a share of the largest number, and of the
variance as a share of its square: LeRobot adds up squares of 32 bits."""

BINS_OFF = 1.5
"""Largest difference of quantiles, in bins of LeRobot's histogram: one, and rounding."""


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
    """The Python of LeRobot's environment, or what stands for it."""
    if given := os.environ.get("OPPOSABLE_LEROBOT"):
        return Path(given).absolute()
    path = tmp_path_factory.mktemp("environment") / "python"
    path.write_text(STAND_IN.format(python=sys.executable))
    path.chmod(0o755)
    return path


@pytest.fixture(scope="module")
def reports(plan_of: PlanOf) -> list[TrialReport]:
    brief = Timeline.quick(lift=0.3, hold=0.2)
    return [simulate(plan_of("allegro_hand", spec), timeline=brief) for spec in ("box", "sphere")]


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
    return home, _read(python, home, written.frames, folder / "read.npz")[1]


def _read(
    python: Path, home: Path, frames: int, out: Path
) -> tuple[dict[str, Any], dict[str, Any]]:
    """What LeRobot says of a data set, and what it reads of it."""
    chosen = np.linspace(0, frames - 1, LOOKED_AT).round().astype(int)
    # isolated: no module of the current folder is imported
    words = [str(python), "-I", str(LAUNCH), str(home), str(out), *map(str, chosen)]
    text = subprocess.run(words, capture_output=True, text=True, check=True).stdout
    told: dict[str, Any] = json.loads(text.splitlines()[-1])
    with np.load(out, allow_pickle=False) as loaded:
        return told, dict(loaded)


def _columns_off(episodes: Sequence[Episode], found: dict[str, Any]) -> float:
    """Largest difference of a column from the recordings, relative where numbers are above 1."""
    largest = 0.0
    recorded = [_recorded(episode) for episode in episodes]
    for key in recorded[0]:
        wanted = np.concatenate([columns[key] for columns in recorded]).astype(np.float64)
        read = found[f"column/{key}"].astype(np.float64)
        assert read.shape == wanted.shape, key
        off = np.abs(read - wanted) / np.maximum(1.0, np.abs(wanted))
        largest = max(largest, float(off.max()))
    return largest


def _recorded(episode: Episode) -> dict[str, Any]:
    """Columns of an episode in the recording's own precision."""
    states, m = episode.recording, len(episode) - 1
    columns: dict[str, Any] = dict(frames_of(episode))
    columns["observation.state"] = states.q[:m]
    columns["observation.base_pose"] = states.T_world_base[:m]
    columns["observation.object_pose"] = states.T_world_object[:m]
    columns["observation.contact_force"] = np.nan_to_num(states.forces[:m]).reshape(m, -1)
    columns["action"] = states.commands[1:]
    return columns


def _indexes_right(episodes: Sequence[Episode], found: dict[str, Any], fps: int) -> bool:
    """Whether indexes, times and flags are those of the recordings, and items those of columns."""
    lengths = [len(episode) - 1 for episode in episodes]
    starts = np.repeat(np.cumsum([0, *lengths[:-1]]), lengths)
    index = np.arange(sum(lengths))
    sentences = list(dict.fromkeys(episode.sentence for episode in episodes))
    tasks = [sentences.index(e.sentence) for e in episodes]
    wanted = {
        "index": index,
        "frame_index": index - starts,
        "episode_index": np.repeat(np.arange(len(episodes)), lengths),
        "task_index": np.repeat(tasks, lengths),
        "timestamp": ((index - starts) / fps).astype(np.float32),
    }
    same = [np.array_equal(found[f"column/{key}"], values) for key, values in wanted.items()]
    chosen = found["item/index"]
    names = [n.removeprefix("column/") for n in found if n.startswith("column/")]
    same += [np.array_equal(found[f"item/{n}"], found[f"column/{n}"][chosen]) for n in names]
    told = [sentences[k] for k in found["item/task_index"]]
    return all(same) and told == found["item/task"].tolist()


def _film_off(home: Path, found: dict[str, Any]) -> float:
    """Largest mean difference (levels of 255) of a frame from what ffmpeg decodes at its place."""
    import imageio_ffmpeg

    largest = 0.0
    for k, i, picture in zip(
        found["item/episode_index"],
        found["item/frame_index"],
        found[f"item/{VIDEO_KEY}"],
        strict=True,
    ):
        path = home / "videos" / VIDEO_KEY / "chunk-000" / f"file-{k:03d}.mp4"
        chosen = ["-i", str(path), "-vf", f"select=eq(n\\,{i})", "-frames:v", "1"]
        raw = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
        done = subprocess.run(
            [imageio_ffmpeg.get_ffmpeg_exe(), "-loglevel", "error", *chosen, *raw],
            capture_output=True,
            check=True,
        )
        seen = 255.0 * picture.transpose(1, 2, 0)
        pixels = np.frombuffer(done.stdout, dtype=np.uint8).reshape(seen.shape)
        largest = max(largest, float(np.abs(seen - pixels).mean()))
    return largest


def _statistics_off(found: dict[str, Any]) -> float:
    """Largest difference of stored from LeRobot's statistics, see ``STATISTICS_OFF``.

    Variances are compared, not their roots: a column that stands still has a standard deviation of
    0, and LeRobot's is the root of what rounding leaves of its squares.
    """
    largest = 0.0
    for key, name in _statistics(found):
        ours, theirs = found[f"stored/{key}/{name}"], found[f"theirs/{key}/{name}"]
        scale = _scale(found, key)
        if name == "std":
            ours, theirs, scale = ours**2, theirs**2, scale**2
        if not name.startswith("q"):
            largest = max(largest, float(np.abs(theirs - ours).max()) / scale)
    return largest


def _quantiles_off(found: dict[str, Any]) -> float:
    """Largest difference of stored from LeRobot's quantiles, in bins of its histogram."""
    bins = []
    for key, name in _statistics(found):
        if name.startswith("q"):
            width = found[f"theirs/{key}/max"] - found[f"theirs/{key}/min"]
            off = np.abs(found[f"theirs/{key}/{name}"] - found[f"stored/{key}/{name}"])
            bins.append(float((off / np.maximum(width / 5000, 1e-6)).max()))
    return max(bins)


def _statistics(found: dict[str, Any]) -> list[tuple[str, str]]:
    """Keys of features, and names of their statistics."""
    return [
        (name.split("/")[1], name.split("/")[2]) for name in found if name.startswith("theirs/")
    ]


def _scale(found: dict[str, Any], key: str) -> float:
    ends = (found[f"theirs/{key}/min"], found[f"theirs/{key}/max"])
    return max(1.0, *(float(np.abs(end).max()) for end in ends))


def test_what_was_written_agrees(
    read: tuple[Path, dict[str, Any]], reports: list[TrialReport]
) -> None:
    home, found = read
    episodes = [episode for report in reports for episode in episodes_of(report)]
    assert 0 < _columns_off(episodes, found) <= MOST_OFF
    assert _indexes_right(episodes, found, 50)
    assert _film_off(home, found) <= MOST_LEVELS
    assert _statistics_off(found) <= STATISTICS_OFF
    assert _quantiles_off(found) <= BINS_OFF


def test_faults_are_noticed(read: tuple[Path, dict[str, Any]], reports: list[TrialReport]) -> None:
    home, found = read
    episodes = [episode for report in reports for episode in episodes_of(report)]

    def spoiled(key: str, change: Any) -> dict[str, Any]:
        return {**found, key: change(found[key])}

    late = spoiled("column/action", lambda rows: np.roll(rows, 1, axis=0))
    assert _columns_off(episodes, late) > MOST_OFF
    assert _columns_off(episodes[::-1], found) > MOST_OFF
    for key in ("column/index", "column/task_index", "column/timestamp", "item/observation.state"):
        assert not _indexes_right(episodes, spoiled(key, lambda v: v + 1), 50), key
    assert not _indexes_right(episodes, found, 25)
    assert not _indexes_right(episodes, spoiled("item/task", lambda v: v[::-1]), 50)
    pictures = f"item/{VIDEO_KEY}"
    moved = spoiled(pictures, lambda v: np.roll(v, 1, axis=0))  # frames of other rows
    assert _film_off(home, moved) > MOST_LEVELS
    wrong = spoiled("stored/action/mean", lambda v: v + 0.01)
    assert _statistics_off(wrong) > STATISTICS_OFF
    wrong = spoiled("stored/action/q50", lambda v: v + 0.01)
    assert _quantiles_off(wrong) > BINS_OFF
