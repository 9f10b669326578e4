"""``run_episodes``: trials are written as LeRobot data sets, and LeRobot reads them back.

Per hand one data set: every column and index is compared with the recordings that it was made of,
frames of the films with the pictures that another decoder has at their place, and the stored
statistics with those that LeRobot's own functions compute.
"""

from __future__ import annotations

import json
import os
import subprocess
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, ClassVar

import numpy as np

from benchmarks.dexgraspbench.checkout import command
from benchmarks.run import Job, measure
from planner.errors import NoGraspFoundError, TaskError
from planner.search import plan_grasp
from planner.task import GraspTask
from sim.episodes import Episode, episodes_of, write_lerobot
from sim.episodes.lerobot import VIDEO_KEY, frames_of
from sim.runner import Check, Runner
from sim.tables import Row, number, table_of
from sim.trial import simulate

LAUNCH = Path(__file__).with_name("launch.py")
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


@dataclass(frozen=True, kw_only=True)
class _HandJob(Job):
    """The data set of one hand."""

    SHOWN: ClassVar[tuple[str, ...]] = ("hand",)

    hand: str
    objects: tuple[str, ...]
    n: int
    seed: int
    python: str
    folder: str | None


def run_episodes(
    hands: Sequence[str],
    objects: Sequence[str],
    n: int,
    *,
    python: Path,
    folder: Path | None,
    seed: int,
    runner: Runner,
) -> Row:
    """Write and read data sets.

    Args:
        hands: A data set each.
        objects: What is grasped.
        n: Grasps per object.
        python: Of an environment with LeRobot.
        folder: Where the data sets are kept; they are deleted if None.
        seed: Of the first grasp.
        runner: Who works.

    Raises:
        TaskError: LeRobot is not there or cannot read.
    """
    jobs = [
        _HandJob(
            index=i,
            hand=hand,
            objects=tuple(objects),
            n=n,
            seed=seed,
            python=str(python),
            folder=None if folder is None else str(folder / f"{i}-{Path(hand).stem}"),
        )
        for i, hand in enumerate(hands)
    ]
    return measure(
        runner,
        _work,
        jobs,
        kind="opposable-episodes-check",
        title="episodes",
        lost=_HandJob.lost,
        objects=list(objects),
        n=n,
        seed=seed,
    )


def _work(job: _HandJob, check: Check) -> Row:
    reports = []
    for spec in job.objects:
        for k in range(job.n):
            check()
            task = GraspTask.create(job.hand, spec)
            try:
                reports.append(simulate(plan_grasp(task, seed=job.seed + k)))
            except NoGraspFoundError:
                continue
    with TemporaryDirectory() as scratch:
        home = Path(job.folder or Path(scratch) / "data")
        begun, cpu = os.times(), time.process_time()
        written = write_lerobot(reports, home, video=True, failed=True)
        ended = os.times()
        cpu = time.process_time() - cpu
        encoding = ended.children_user - begun.children_user
        check()
        told, found = _read(Path(job.python), home, written.frames, Path(scratch) / "read.npz")
        episodes = [e for report in reports for e in episodes_of(report)]
        sizes = [f.stat().st_size for f in home.rglob("*") if f.is_file()]
        films = [f.stat().st_size for f in home.rglob("*.mp4")]
        return job.row(
            **told,
            written_frames=written.frames,
            written_episodes=written.episodes,
            succeeded=written.succeeded,
            largest_difference=_columns_off(episodes, found),
            indexes_right=_indexes_right(episodes, found, told["fps"]),
            film_levels_off=_film_off(home, found),
            statistics_off=_statistics_off(found),
            quantile_bins_off=_quantiles_off(found),
            write_cpu_s=cpu / written.episodes,
            encode_cpu_s=encoding / written.episodes,
            kilobytes=sum(sizes) / 1e3 / written.episodes,
            film_kilobytes=sum(films) / 1e3 / written.episodes,
        )


def _read(python: Path, home: Path, frames: int, out: Path) -> tuple[Row, dict[str, Any]]:
    """What LeRobot says of a data set, and what it reads of it."""
    chosen = np.linspace(0, frames - 1, LOOKED_AT).round().astype(int)
    # isolated: no module of the current folder is imported
    words = [str(python), "-I", str(LAUNCH), str(home), str(out), *map(str, chosen)]
    text = command(words, "LeRobot")
    told: Row = json.loads(text.splitlines()[-1])
    with np.load(out, allow_pickle=False) as loaded:
        return told, dict(loaded)


def _columns_off(episodes: Sequence[Episode], found: dict[str, Any]) -> float:
    """Largest difference of a column from the recordings, relative where numbers are above 1."""
    largest = 0.0
    recorded = [_recorded(episode) for episode in episodes]
    for key in recorded[0]:
        wanted = np.concatenate([columns[key] for columns in recorded]).astype(np.float64)
        read = found[f"column/{key}"].astype(np.float64)
        if read.shape != wanted.shape:
            raise TaskError(f"LeRobot reads {key} in shape {read.shape}, not {wanted.shape}")
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


def agrees(result: Row) -> bool:
    """Whether LeRobot read of every data set what was recorded."""
    return all(
        "error" not in row
        and row["indexes_right"]
        and (row["frames"], row["episodes"]) == (row["written_frames"], row["written_episodes"])
        and row["largest_difference"] <= MOST_OFF
        and row["film_levels_off"] <= MOST_LEVELS
        and row["statistics_off"] <= STATISTICS_OFF
        and row["quantile_bins_off"] <= BINS_OFF
        for row in result["rows"]
    )


def episodes_table(result: Row) -> Any:
    """A row per hand."""
    table = table_of(
        f"data sets of episodes as LeRobot reads them (largest allowed difference {MOST_OFF:g})",
        ("hand", "lerobot", "indexes"),
        (
            "episodes",
            "frames",
            "difference",
            "film (levels)",
            "statistics",
            "quantiles (bins)",
            "CPU s/episode",
            "kB/episode",
        ),
    )
    for row in result["rows"]:
        if "error" in row:
            table.add_row(row["hand"], row["error"])
            continue
        table.add_row(
            row["hand"],
            f"{row['lerobot']}, torch {row['torch']}",
            "right" if row["indexes_right"] else "WRONG",
            f"{row['episodes']}/{row['written_episodes']}",
            f"{row['frames']}/{row['written_frames']}",
            f"{row['largest_difference']:.1e}",
            number(row["film_levels_off"], 2),
            f"{row['statistics_off']:.1e}",
            number(row["quantile_bins_off"], 2),
            f"{row['write_cpu_s']:.2f} + {row['encode_cpu_s']:.2f}",
            f"{row['kilobytes']:.0f}, film {row['film_kilobytes']:.0f}",
        )
    return table
