"""LeRobot data sets, version 3.0: Parquet, JSON and films that ``LeRobotDataset`` reads.

The layout follows huggingface/lerobot at tag v0.6.1, which reads version 3.0
(``src/lerobot/datasets``: ``dataset_metadata.py``, ``dataset_writer.py``, ``utils.py``,
``feature_utils.py``, ``compute_stats.py``; looked up at commit
7427f31801f944f5ec9ce53cda02862ce7d1638b).

What a row of a LeRobot data set holds: features with their type, shape, names and units.

Frame k pairs what is seen at sample k with the action that leads to sample k + 1: the command in
force when sample k + 1 was taken. So an episode of m samples has m - 1 frames, and the last sample
is the state that the last action leads to.

Statistics of the features of a data set, by which LeRobot's policies normalise.

Per episode and feature: least and greatest value, mean, standard deviation, number of frames and
five quantiles; those of the data set follow from the episodes' as LeRobot makes them, quantiles as
means weighted by frames. LeRobot estimates an episode's quantiles by a histogram of 5000 bins;
here they are exact, which differs by less than a bin.

``LeRobotWriter``: writes episodes into the files of a LeRobot data set.

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
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from planner.batch.rows import arrow
from planner.files import write_json
from planner.spatial import FloatArray
from sim.datasets.episodes.episode import (
    Asked,
    Episode,
    EpisodeFormat,
    Robot,
    frames_at,
    register_format,
)
from sim.datasets.episodes.writing import check_films, draw_episode
from sim.show.painter import Pixels

VIDEO_KEY = "observation.images.front"
"""Key of the film."""

POSE = ["x", "y", "z", "qw", "qx", "qy", "qz"]
POSE_UNITS = ["m", "m", "m", "-", "-", "-", "-"]

INDEX_FEATURES: dict[str, dict[str, Any]] = {
    "timestamp": {"dtype": "float32", "shape": [1], "names": None},
    "frame_index": {"dtype": "int64", "shape": [1], "names": None},
    "episode_index": {"dtype": "int64", "shape": [1], "names": None},
    "index": {"dtype": "int64", "shape": [1], "names": None},
    "task_index": {"dtype": "int64", "shape": [1], "names": None},
}
"""Features that every LeRobot data set has, with the types that it must have them in."""


def features_of(robot: Robot) -> dict[str, dict[str, Any]]:
    """Features of a robot's data set without its film, as ``meta/info.json`` has them.

    Units stand in "info" of a feature, where LeRobot keeps what it does not interpret.
    """
    forces = [f"{name}.{axis}" for name in robot.contact_names for axis in "xyz"]
    touch = list(robot.contact_names)
    return {
        "observation.state": _vector(
            robot.joint_names, robot.joint_units, "joint positions of the hand, and of its arm"
        ),
        "observation.base_pose": _vector(POSE, POSE_UNITS, "pose of the hand's base, world"),
        "observation.object_pose": _vector(POSE, POSE_UNITS, "pose of the object, world"),
        "observation.contact_force": _vector(
            forces, ["N"] * len(forces), "force of each finger on the object, world; 0 off it"
        ),
        "observation.touch": _vector(
            touch, ["-"] * len(touch), "1 where a finger or the palm touches the object, else 0"
        ),
        "action": _vector(
            robot.actuator_names,
            robot.command_units,
            "command of each actuator at the end of the interval that begins with this frame",
        ),
        "next.done": _flag("whether the episode ends with the next state"),
        "next.success": _flag("whether it ends so, and the trial's verdict is success"),
        **INDEX_FEATURES,
    }


def video_feature(size: tuple[int, int], fps: int) -> dict[str, Any]:
    """The feature of the film: width and height in pixels, frames per second."""
    width, height = size
    return {
        "dtype": "video",
        "shape": [height, width, 3],
        "names": ["height", "width", "channels"],
        "info": {
            "video.height": height,
            "video.width": width,
            "video.codec": "h264",
            "video.pix_fmt": "yuv420p",
            "video.fps": fps,
            "video.channels": 3,
            "has_audio": False,
            "is_depth_map": False,
        },
    }


def frames_of(episode: Episode) -> dict[str, NDArray[Any]]:
    """Columns of an episode's frames, (m - 1, ...) each, without the index features.

    Args:
        episode: Its samples are the frames and the state after the last.
    """
    states, count = episode.recording, len(episode) - 1
    touching = np.isfinite(states.points[:, :, 0])
    forces = np.where(touching[..., None], states.forces, 0.0)
    last = np.arange(count) == count - 1
    single = {
        "observation.state": states.q,
        "observation.base_pose": states.T_world_base,
        "observation.object_pose": states.T_world_object,
        "observation.contact_force": forces.reshape(len(states), -1),
        "observation.touch": touching,
    }
    return {
        **{key: values[:count].astype(np.float32) for key, values in single.items()},
        "action": states.commands[1:].astype(np.float32),
        "next.done": last,
        "next.success": last & episode.success,
    }


def _vector(names: Any, units: Any, description: str) -> dict[str, Any]:
    return {
        "dtype": "float32",
        "shape": [len(names)],
        "names": list(names),
        "info": {"units": list(units), "description": description},
    }


def _flag(description: str) -> dict[str, Any]:
    return {"dtype": "bool", "shape": [1], "names": None, "info": {"description": description}}


Statistics: TypeAlias = dict[str, FloatArray]
"""Name of a statistic -> its values, one per number of the feature; "count" has one."""

QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}

LARGEST_PICTURE, SMALLER_PICTURE = 300, 150
"""Pictures at least so wide or high (pixels) are thinned to about the second size, as LeRobot does
before it looks at them."""


def of_columns(columns: Mapping[str, NDArray[Any]]) -> dict[str, Statistics]:
    """Statistics of every column (m,) or (m, n) of an episode."""
    return {key: _of_column(values) for key, values in columns.items()}


def _of_column(values: NDArray[Any]) -> Statistics:
    rows = values.reshape(len(values), -1).astype(np.float64)
    quantiles = np.quantile(rows, list(QUANTILES.values()), axis=0, method="inverted_cdf")
    return {
        "min": rows.min(axis=0),
        "max": rows.max(axis=0),
        "mean": rows.mean(axis=0),
        "std": rows.std(axis=0),
        "count": np.array([len(rows)]),
        **dict(zip(QUANTILES, quantiles, strict=True)),
    }


def of_pictures(pictures: Sequence[Pixels]) -> Statistics:
    """Statistics of pictures (height, width, 3), per colour, (3, 1, 1) each, in [0, 1]."""
    height, width, _ = pictures[0].shape
    step = 1
    if max(height, width) >= LARGEST_PICTURE:
        step = int((width if width > height else height) / SMALLER_PICTURE)
    counts = np.zeros((3, 256))
    for picture in pictures:
        for channel in range(3):
            counts[channel] += np.bincount(picture[::step, ::step, channel].ravel(), minlength=256)
    level = np.arange(256) / 255.0
    total = counts.sum(axis=1)
    mean = counts @ level / total
    variance = counts @ level**2 / total - mean**2
    below = counts.cumsum(axis=1)
    found = {
        "min": level[(counts > 0).argmax(axis=1)],
        "max": level[255 - (counts[:, ::-1] > 0).argmax(axis=1)],
        "mean": mean,
        "std": np.sqrt(np.maximum(variance, 0.0)),
        **{n: level[(below >= q * total[:, None]).argmax(axis=1)] for n, q in QUANTILES.items()},
    }
    shaped = {name: np.asarray(values).reshape(3, 1, 1) for name, values in found.items()}
    return {**shaped, "count": np.array([len(pictures)])}


def of_all(episodes: Sequence[Statistics]) -> Statistics:
    """Statistics of a feature over a data set from those of its episodes."""
    counts = np.array([one["count"][0] for one in episodes], dtype=np.float64)
    share = counts / counts.sum()

    def weighted(values: Sequence[FloatArray]) -> FloatArray:
        return np.asarray(np.tensordot(share, np.array(values), axes=1))

    mean = weighted([one["mean"] for one in episodes])
    variance = weighted([one["std"] ** 2 + (one["mean"] - mean) ** 2 for one in episodes])
    return {
        "min": np.min([one["min"] for one in episodes], axis=0),
        "max": np.max([one["max"] for one in episodes], axis=0),
        "mean": mean,
        "std": np.sqrt(variance),
        "count": np.array([int(counts.sum())]),
        **{name: weighted([one[name] for one in episodes]) for name in QUANTILES},
    }


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
    """One data set in a new folder; see ``sim.datasets.episodes.EpisodeWriter``."""

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
        "source": episode.source,
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


register_format(
    EpisodeFormat(
        name="lerobot",
        title="LeRobot data set, version 3.0",
        loses="Numbers are 32 bits wide; places, normals and friction of contacts, phases, and "
        "samples between frames are left out.",
        films=True,
        writer=LeRobotWriter,
    )
)
