"""``LeRobotWriter``: writes episodes into the files of a LeRobot data set.

    meta/info.json                               version, frame rate, features
    meta/stats.json                              statistics of the features
    meta/tasks.parquet                           task sentences by number
    meta/episodes/chunk-000/file-000.parquet     a row per episode
    data/chunk-000/file-000.parquet              a row per frame, a row group per episode
    videos/KEY/chunk-000/file-000.mp4            a film per episode

Data files hold many episodes, up to 100 MB. A film is a file of its own, so that an episode whose
film fails is not half in a film of others.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from planner.batch.rows import arrow
from planner.files import write_json
from sim.episodes.episode import Episode
from sim.episodes.film import check_films, draw_episode
from sim.episodes.formats import Asked
from sim.episodes.lerobot.features import VIDEO_KEY, features_of, frames_of, video_feature
from sim.episodes.lerobot.statistics import Statistics, of_all, of_columns, of_pictures
from sim.episodes.robot import Robot
from sim.episodes.sampling import frames_at

CODEBASE_VERSION = "v3.0"
"""Version of the layout."""

CHUNK = 1000
"""Files per folder."""

DATA_MB, VIDEO_MB = 100, 200
"""Sizes (MB) from which a new file is begun."""

MB = 1 << 20
PARQUET = "chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
DATA = f"data/{PARQUET}"
EPISODES = f"meta/episodes/{PARQUET}"
VIDEO = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"


class LeRobotWriter:
    """One data set in a new folder; see ``formats.EpisodeWriter``."""

    def __init__(self, folder: Path, asked: Asked) -> None:
        """Begin.

        Args:
            folder: Empty.
            asked: Frame rate and film.

        Raises:
            TaskError: ``pyarrow`` is missing, or films cannot be made.
        """
        arrow()
        if asked.video:
            check_films(asked.size)
        self._folder, self._asked = folder, asked
        self._fps = asked.fps
        self._robot: Robot | None = None
        self._tasks: dict[str, int] = {}
        self._frames = self._file = 0
        self._data: Any = None
        self._data_path = folder / DATA.format(chunk_index=0, file_index=0)
        self._episodes: list[dict[str, Any]] = []
        self._statistics: list[dict[str, Statistics]] = []

    def add(self, episode: Episode) -> int:
        """Add an episode; the number of its frames.

        Raises:
            TaskError: Its sample times do not fit the frame rate, or it cannot be filmed.
            OSError: The folder cannot be written.
        """
        fps, samples = frames_at(episode.recording.time, self._fps, episode.source)
        framed = episode.taken(samples)
        columns, number = frames_of(framed), len(self._episodes)
        count = len(columns["action"])
        task = self._tasks.get(episode.sentence, len(self._tasks))
        columns |= {
            "timestamp": np.asarray(np.arange(count) / fps, dtype=np.float32),
            "frame_index": np.arange(count),
            "episode_index": np.full(count, number),
            "index": np.arange(self._frames, self._frames + count),
            "task_index": np.full(count, task),
        }
        statistics = of_columns(columns)
        place: dict[str, Any] = {}
        if self._asked.video:
            place, statistics[VIDEO_KEY] = self._film(framed, number, fps)
        self._write_rows(episode.robot, columns)
        self._fps, self._robot = fps, self._robot or episode.robot
        self._tasks.setdefault(episode.sentence, task)
        self._statistics.append(statistics)
        chunk, file = divmod(self._file, CHUNK)
        self._episodes.append(
            {
                "episode_index": number,
                "tasks": [episode.sentence],
                "length": count,
                "data/chunk_index": chunk,
                "data/file_index": file,
                "dataset_from_index": self._frames,
                "dataset_to_index": self._frames + count,
                **place,
                "meta/episodes/chunk_index": 0,
                "meta/episodes/file_index": 0,
                **_told(episode),
            }
        )
        self._frames += count
        return count

    def finish(self) -> None:
        """Write the metadata and close the data."""
        pa = arrow()
        self._data.close()
        rows = [
            episode
            | {
                f"stats/{key}/{name}": values.tolist()
                for key, statistics in made.items()
                for name, values in statistics.items()
            }
            for episode, made in zip(self._episodes, self._statistics, strict=True)
        ]
        path = self._folder / EPISODES.format(chunk_index=0, file_index=0)
        path.parent.mkdir(parents=True)
        pa.parquet.write_table(pa.Table.from_pylist(rows), path)
        pa.parquet.write_table(_tasks_table(self._tasks), self._folder / "meta" / "tasks.parquet")
        every = {key: of_all([made[key] for made in self._statistics]) for key in self._features()}
        write_json(
            {key: {n: v.tolist() for n, v in one.items()} for key, one in every.items()},
            self._folder / "meta" / "stats.json",
        )
        write_json(self._info(), self._folder / "meta" / "info.json")

    def abandon(self) -> None:
        """Close what is open."""
        if self._data is not None:
            self._data.close()

    def _features(self) -> dict[str, dict[str, Any]]:
        assert self._robot is not None and self._fps is not None  # an episode was added
        film = {VIDEO_KEY: video_feature(self._asked.size, self._fps)} if self._asked.video else {}
        return {**features_of(self._robot), **film}

    def _info(self) -> dict[str, Any]:
        assert self._robot is not None
        return {
            "codebase_version": CODEBASE_VERSION,
            "robot_type": self._robot.name,
            "total_episodes": len(self._episodes),
            "total_frames": self._frames,
            "total_tasks": len(self._tasks),
            "chunks_size": CHUNK,
            "data_files_size_in_mb": DATA_MB,
            "video_files_size_in_mb": VIDEO_MB,
            "fps": self._fps,
            "splits": {"train": f"0:{len(self._episodes)}"},
            "data_path": DATA,
            "video_path": VIDEO if self._asked.video else None,
            "features": self._features(),
        }

    def _film(self, episode: Episode, number: int, fps: int) -> tuple[dict[str, Any], Statistics]:
        """Draw the film of an episode; where it is, and the statistics of its pictures.

        The state after the last frame is no frame and is not in it.
        """
        chunk, file = divmod(number, CHUNK)
        path = self._folder / VIDEO.format(video_key=VIDEO_KEY, chunk_index=chunk, file_index=file)
        path.parent.mkdir(parents=True, exist_ok=True)
        shown = episode.taken(range(len(episode) - 1))
        view, pictures = draw_episode(shown, path, fps=fps, size=self._asked.size)
        place = {
            f"videos/{VIDEO_KEY}/chunk_index": chunk,
            f"videos/{VIDEO_KEY}/file_index": file,
            f"videos/{VIDEO_KEY}/from_timestamp": 0.0,
            f"videos/{VIDEO_KEY}/to_timestamp": len(shown) / fps,
            "camera_lookat_m": view.lookat.tolist(),
            "camera_distance_m": view.distance,
            "camera_azimuth_deg": view.azimuth,
            "camera_elevation_deg": view.elevation,
        }
        return place, of_pictures(pictures)

    def _write_rows(self, robot: Robot, columns: dict[str, Any]) -> None:
        """Write an episode's frames as a row group, into a new file where the old one is full."""
        pa = arrow()
        fields, arrays = [], []
        for key, feature in features_of(robot).items():
            kind, width = pa.type_for_alias(feature["dtype"]), feature["shape"][0]
            flat = pa.array(columns[key].ravel(), type=kind)
            if feature["shape"] == [1]:
                arrays.append(flat)
            else:
                arrays.append(pa.FixedSizeListArray.from_arrays(flat, width))
            fields.append(pa.field(key, arrays[-1].type))
        table = pa.table(arrays, schema=pa.schema(fields))
        if self._data is not None and self._data_path.stat().st_size >= DATA_MB * MB:
            self._data.close()
            self._data, self._file = None, self._file + 1
        if self._data is None:
            chunk, file = divmod(self._file, CHUNK)
            self._data_path = self._folder / DATA.format(chunk_index=chunk, file_index=file)
            self._data_path.parent.mkdir(parents=True, exist_ok=True)
            self._data = pa.parquet.ParquetWriter(self._data_path, table.schema)
        self._data.write_table(table)


def _told(episode: Episode) -> dict[str, Any]:
    """Columns of ours in the table of episodes, which LeRobot hands through."""
    return {
        "success": episode.success,
        "reason": episode.reason,
        "kind": episode.kind,
        "object": episode.object,
        "mass_kg": episode.mass_kg,
        "seed": episode.seed,
        "controller": episode.controller,
        "fingers": list(episode.fingers),
        "begin_s": float(episode.recording.time[0]),
    }


def _tasks_table(tasks: dict[str, int]) -> Any:
    """The table of tasks, whose index in pandas is the sentence, as LeRobot reads it."""
    pa = arrow()
    columns = [("task_index", "int64", "int64"), ("task", "unicode", "object")]
    described = {
        "index_columns": ["task"],
        "column_indexes": [],
        "columns": [
            {
                "name": name,
                "field_name": name,
                "pandas_type": kind,
                "numpy_type": stored,
                "metadata": None,
            }
            for name, kind, stored in columns
        ],
        "creator": {"library": "pyarrow", "version": pa.__version__},
        "pandas_version": "2.2.0",
    }
    table = pa.table({"task_index": list(tasks.values()), "task": list(tasks)})
    return table.replace_schema_metadata({"pandas": json.dumps(described)})
