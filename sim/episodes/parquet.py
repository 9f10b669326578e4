"""Plain Parquet: a table with a row per sample and one with a row per episode, written and read.

    samples.parquet     states, commands and contacts, 64 bits wide; a row group per episode
    episodes.parquet    what was done, with what outcome

Every column has its description, unit and frame in its metadata; a contact is null where there is
none. ``read_episodes`` gives the recordings back to the last bit.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner.batch.rows import arrow
from planner.errors import FileFormatError, shown
from planner.spatial import FloatArray
from planner.version import written_by
from sim.episodes.episode import Episode, Robot, frames_at
from sim.episodes.formats import Asked, EpisodeFormat, register_format
from sim.recording import Recording

FORMAT, VERSION = "opposable-episodes", "1"
"""Keys "format" and "version" of the metadata of both files."""

SAMPLES, EPISODES = "samples.parquet", "episodes.parquet"

POSE = (("x", "m"), ("y", "m"), ("z", "m"), ("qw", "-"), ("qx", "-"), ("qy", "-"), ("qz", "-"))


@dataclass(frozen=True, kw_only=True)
class Column:
    """A column of numbers in the table of samples.

    Attributes:
        name: Its name.
        unit: Unit, "-" for none.
        about: What it is, with its frame.
        values: Its values (m,) in a recording.
    """

    name: str
    unit: str
    about: str
    values: Callable[[Recording], FloatArray]


def columns_of(robot: Robot) -> Iterator[Column]:
    """The columns of a robot's samples, in order; NaN where there is no contact."""

    def column(name: str, unit: str, about: str, field: str, *place: int) -> Column:
        def values(states: Recording) -> FloatArray:
            found: FloatArray = getattr(states, field)[(slice(None), *place)]
            return found

        return Column(name=name, unit=unit, about=about, values=values)

    yield column("time_s", "s", "time since the trial began", "time")
    for i, (name, unit) in enumerate(zip(robot.joint_names, robot.joint_units, strict=True)):
        yield column(f"joint.{name}", unit, "position of a joint", "q", i)
    for i, (axis, unit) in enumerate(POSE):
        yield column(f"base.{axis}", unit, "pose of the hand's base, world", "T_world_base", i)
    for i, (axis, unit) in enumerate(POSE):
        yield column(f"object.{axis}", unit, "pose of the object, world", "T_world_object", i)
    for i, (name, unit) in enumerate(zip(robot.actuator_names, robot.command_units, strict=True)):
        yield column(
            f"command.{name}", unit, "command in force when the sample was taken", "commands", i
        )
    for k, name in enumerate(robot.contact_names):
        for i, axis in enumerate("xyz"):
            about = "where it touches the object, world"
            yield column(f"contact.{name}.{axis}", "m", about, "points", k, i)
        for i, axis in enumerate("xyz"):
            about = "contact normal, unit, into the object, world"
            yield column(f"normal.{name}.{axis}", "-", about, "normals", k, i)
        for i, axis in enumerate("xyz"):
            yield column(f"force.{name}.{axis}", "N", "on the object, world", "forces", k, i)
        yield column(f"mu.{name}", "-", "sliding friction of the contact", "friction", k, 0)
        yield column(f"mu_torsion.{name}", "m", "torsional friction", "friction", k, 1)


class ParquetWriter:
    """One data set in a new folder; see ``formats.EpisodeWriter``."""

    def __init__(self, folder: Path, asked: Asked) -> None:
        """Begin.

        Args:
            folder: Empty.
            asked: Frame rate; without one, all samples are rows.

        Raises:
            TaskError: ``pyarrow`` is missing.
        """
        arrow()
        self._folder, self._asked = folder, asked
        self._robot: Robot | None = None
        self._samples: Any = None
        self._rows: list[dict[str, Any]] = []
        self._written = 0

    def add(self, episode: Episode) -> int:
        """Add an episode; the number of its rows.

        Raises:
            TaskError: Its sample times do not fit the frame rate that was asked for.
            OSError: The folder cannot be written.
        """
        if self._asked.fps is not None:
            _, samples = frames_at(episode.recording.time, self._asked.fps, episode.source)
            episode = episode.taken(samples)
        pa, states, number = arrow(), episode.recording, len(self._rows)
        schema = _schema(episode.robot, states.control_range)
        numbers = [column.values(states) for column in columns_of(episode.robot)]
        touch = np.isfinite(states.points[:, :, 0])
        columns = [
            pa.array(np.full(len(states), number)),
            pa.array(np.arange(len(states))),
            pa.array(list(states.phase), type=pa.string()),
            *(pa.array(np.ascontiguousarray(v), from_pandas=True) for v in numbers),
            *(pa.array(np.ascontiguousarray(touch[:, k])) for k in range(touch.shape[1])),
        ]
        if self._samples is None:
            self._samples = pa.parquet.ParquetWriter(self._folder / SAMPLES, schema)
        self._samples.write_table(pa.table(columns, schema=self._samples.schema))
        self._rows.append(
            {
                "episode": number,
                "kind": episode.kind,
                "task": episode.sentence,
                "success": episode.success,
                "reason": episode.reason,
                "object": episode.object,
                "mass_kg": episode.mass_kg,
                "seed": episode.seed,
                "controller": episode.controller,
                "fingers": list(episode.fingers),
                "source": episode.source,
                "first_row": self._written,
                "rows": len(states),
                "begin_s": float(states.time[0]),
                "end_s": float(states.time[-1]),
            }
        )
        self._written += len(states)
        return len(states)

    def finish(self) -> None:
        """Close the samples and write the table of episodes."""
        pa = arrow()
        self._samples.close()
        table = pa.Table.from_pylist(self._rows, schema=_episodes_schema())
        pa.parquet.write_table(table, self._folder / EPISODES)

    def abandon(self) -> None:
        """Close what is open."""
        if self._samples is not None:
            self._samples.close()


def read_episodes(folder: Path | str) -> list[Episode]:
    """Read the episodes of a folder that ``write_parquet`` wrote.

    Their columns of contacts are those of the hand's fingers and the palm. They keep no task, so
    that they cannot be filmed.

    Raises:
        FileFormatError: Missing, damaged, of another format or another version.
        TaskError: ``pyarrow`` is missing.
    """
    pa, folder = arrow(), Path(folder)
    try:
        episodes = pa.parquet.read_table(folder / EPISODES)
        samples = pa.parquet.ParquetFile(folder / SAMPLES)
        for path, schema in ((EPISODES, episodes.schema), (SAMPLES, samples.schema_arrow)):
            _check_format(folder / path, schema.metadata or {})
        rows = episodes.to_pylist()
        if samples.num_row_groups != len(rows):
            raise FileFormatError(
                f"{folder} is damaged: {len(rows)} episodes, {samples.num_row_groups} in {SAMPLES}"
            )
        groups = [samples.read_row_group(i) for i in range(len(rows))]
    except (pa.ArrowException, OSError) as error:
        raise FileFormatError(f"cannot read episodes from {folder}: {error}") from error
    return [_episode(row, group, folder) for row, group in zip(rows, groups, strict=True)]


def _episode(row: dict[str, Any], table: Any, folder: Path) -> Episode:
    """An episode from its row in the one table and its rows in the other."""
    try:
        robot = _robot(table.schema)
        m, nq, nu = len(table), len(robot.joint_names), len(robot.actuator_names)
        given = [_numbers(table[column.name]) for column in columns_of(robot)]
        sizes = (1, nq, 7, 7, nu, 11 * len(robot.contact_names))
        time, q, base, item, commands, contacts = np.split(
            np.array(given).T.reshape(m, -1), np.cumsum(sizes)[:-1], axis=1
        )
        ranges = [table.schema.field(f"command.{name}").metadata for name in robot.actuator_names]
        control = [[float(r[b"lower"]), float(r[b"upper"])] for r in ranges]
        phase = tuple(table["phase"].to_pylist())
    except (KeyError, ValueError, TypeError) as error:
        raise FileFormatError(f"{folder / SAMPLES} is damaged: {error}") from error
    by_finger = contacts.reshape(m, len(robot.contact_names), 11)
    recording = Recording(
        joint_names=robot.joint_names,
        actuator_names=robot.actuator_names,
        control_range=np.array(control).reshape(nu, 2),
        contact_names=robot.contact_names,
        time=time[:, 0],
        phase=phase,
        q=q,
        T_world_base=base,
        T_world_object=item,
        points=by_finger[..., 0:3],
        normals=by_finger[..., 3:6],
        forces=by_finger[..., 6:9],
        friction=by_finger[..., 9:11],
        commands=commands,
    )
    return Episode(
        robot=robot,
        kind=row["kind"],
        sentence=row["task"],
        object=row["object"],
        mass_kg=row["mass_kg"],
        success=row["success"],
        reason=row["reason"],
        seed=row["seed"],
        controller=row["controller"],
        fingers=tuple(row["fingers"]),
        source=row["source"],
        recording=recording,
    )


def _numbers(column: Any) -> NDArray[Any]:
    """A column as numbers, null as NaN."""
    return np.asarray(column.to_numpy(zero_copy_only=False), dtype=np.float64)


def _schema(robot: Robot, control_range: FloatArray) -> Any:
    """Arrow schema of the samples."""
    pa = arrow()
    limits = {
        f"command.{name}": {"lower": repr(float(low)), "upper": repr(float(high))}
        for name, (low, high) in zip(robot.actuator_names, control_range, strict=True)
    }
    fields = [
        pa.field("episode", pa.int64(), metadata={"description": "number of the episode"}),
        pa.field("sample", pa.int64(), metadata={"description": "number in its episode"}),
        pa.field("phase", pa.string(), metadata={"description": "phase of the trial"}),
    ]
    fields += [
        pa.field(
            column.name,
            pa.float64(),
            metadata={
                "description": column.about,
                "unit": column.unit,
                **limits.get(column.name, {}),
            },
        )
        for column in columns_of(robot)
    ]
    fields += [
        pa.field(
            f"touch.{name}", pa.bool_(), metadata={"description": "whether it touches the object"}
        )
        for name in robot.contact_names
    ]
    return pa.schema(fields, metadata=_metadata() | {"robot": json.dumps(asdict(robot))})


def _episodes_schema() -> Any:
    """Arrow schema of the table of episodes."""
    pa = arrow()
    columns = [
        ("episode", pa.int64(), "number of the episode"),
        ("kind", pa.string(), "grasp or manipulation"),
        ("task", pa.string(), "the task in words"),
        ("success", pa.bool_(), "verdict of the trial"),
        ("reason", pa.string(), "why not, empty for success"),
        ("object", pa.string(), "specification of the object"),
        ("mass_kg", pa.float64(), "its mass, kg"),
        ("seed", pa.int64(), "seed of the plan"),
        ("controller", pa.string(), "class that drove the hand"),
        ("fingers", pa.list_(pa.string()), "fingers that take part"),
        ("source", pa.string(), "where the report is from"),
        ("first_row", pa.int64(), "number of its first row among the samples"),
        ("rows", pa.int64(), "number of its rows"),
        ("begin_s", pa.float64(), "time of its first sample, s"),
        ("end_s", pa.float64(), "time of its last sample, s"),
    ]
    fields = [pa.field(n, t, metadata={"description": text}) for n, t, text in columns]
    return pa.schema(fields, metadata=_metadata())


def _metadata() -> dict[str, str]:
    return {"format": FORMAT, "version": VERSION, "written_by": written_by()}


def _robot(schema: Any) -> Robot:
    told: dict[str, Any] = json.loads(schema.metadata[b"robot"])
    named: dict[str, Any] = {k: v if isinstance(v, str) else tuple(v) for k, v in told.items()}
    return Robot(**named)


def _check_format(path: Path, metadata: dict[bytes, bytes]) -> None:
    """Refuse what is not ours.

    Raises:
        FileFormatError: Another format or version.
    """
    found = metadata.get(b"format", b"").decode(), metadata.get(b"version", b"").decode()
    if found[0] != FORMAT:
        raise FileFormatError(f"{path} is of format {shown(found[0])}, not {FORMAT!r}")
    if found[1] != VERSION:
        raise FileFormatError(
            f"{path} is of version {shown(found[1])}; this package reads {VERSION!r}; update it"
        )


register_format(
    EpisodeFormat(
        name="parquet",
        title="plain Parquet, a table of samples and one of episodes",
        loses="The normalised min-weight of every sample, which follows from its contacts.",
        films=False,
        writer=ParquetWriter,
        read=read_episodes,
    )
)
