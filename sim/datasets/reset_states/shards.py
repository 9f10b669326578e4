"""Shards: 64 candidates each, held by workers, kept as one file each that appears whole.

A shard's content is a function of the seed, the cell and its number. So a run that was interrupted
goes on with the shards that are missing, and any number of workers gives the same states.

The folder of a cache: what it was asked for, and what earlier runs left in it.

Its files, where ``NAME`` is one object in one size::

    manifest.json         what was asked for; another request is refused
    check_states.py       holds a sample of states with NumPy and MuJoCo alone
    summary.json          rates, reasons, coverage
    NAME/scene.xml        hand and object, with mesh files if there are any
    NAME/states.npz ...   the states in every format
    NAME/work/            sources and shards, for a run that goes on
    hora/                 caches of HORA

How much of the space of orientations states cover: cells of equal volume on SO(3).

A rotation R is the direction u = R e_z and the angle psi by which R turns about u beyond the
shortest rotation that takes e_z to u. The grid has 6 bands of equal height along z, 12 sectors of
30 degrees around z, and 12 steps of 30 degrees in psi: 864 cells, each with the same share of
uniformly distributed rotations. About the axis of a round object psi means nothing: its coverage is
that of the 72 cells of directions.

Which states are new: of two that are near-duplicates the earlier one is kept.

Two states of a cell are near-duplicates where the object's position differs by at most 1 mm, its
orientation by at most 1 degree, and every joint by at most 1 degree (0.0175, in rad or m). What the
states differ in besides (gravity, mass, friction, commands) does not make them distinct.
"""

from __future__ import annotations

import os
import signal
import time
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from shutil import copyfile
from typing import Any

import numpy as np

from planner.batch.pool import end_with
from planner.batch.store import lock_folder
from planner.errors import FileFormatError, shown
from planner.files import read_json, write_json
from planner.files.disk import read_json_lines, refuse_other_request, whole_file
from planner.spatial import FloatArray, IntArray
from planner.system.package import written_by
from sim.datasets.reset_states.hold import REASONS, hold
from sim.datasets.reset_states.starts import WORK, StatesAsked, load_starts

SHARD = 64
"""Candidates per shard: 1 to 2 s of work."""

HELD = "held"
"""Folder of the shards in ``WORK``."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Shard:
    """The holds of a shard.

    Attributes:
        reason: (64,), 0 for a hold that is kept, else 1 plus the number of its reason in
            ``REASONS``.
        q: Joints (k, nq) of those that are kept.
        commands: Commands (k, nu).
        position: (k, 3), m, in the hand's base.
        quaternion: (k, 4), w, x, y, z.
        gravity: (k, 3), m/s2, in the hand's base.
        mass: (k,), kg.
        friction: (k,).
        source: (k,), rows of the sources.
        cpu_s: CPU seconds that it took.
    """

    reason: IntArray
    q: FloatArray
    commands: FloatArray
    position: FloatArray
    quaternion: FloatArray
    gravity: FloatArray
    mass: FloatArray
    friction: FloatArray
    source: IntArray
    cpu_s: float


@dataclass(frozen=True, kw_only=True)
class ShardJob:
    """A shard that is to be held, as it is sent to a worker.

    Attributes:
        folder: Folder of the cell.
        number: Number of the shard.
        parent: Process that asked for it.
    """

    folder: Path
    number: int
    parent: int


def shard_path(folder: Path, number: int) -> Path:
    """File of a shard of a cell."""
    return folder / WORK / HELD / f"part-{number:06d}.npz"


def held_shard(job: ShardJob) -> tuple[int, Shard]:
    """Hold the candidates of a shard and write its file; its number and content.

    A worker leaves Ctrl-C to the process that started it, and ends with it.
    """
    if os.getpid() != job.parent:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        end_with(job.parent)
    shard = _hold_all(job)
    with whole_file(shard_path(job.folder, job.number)) as stream:
        np.savez(stream, **vars(shard))
    return job.number, shard


def _hold_all(job: ShardJob) -> Shard:
    begin = time.process_time()
    starts = load_starts(job.folder)
    reasons, rows = [], []
    for index in range(job.number * SHARD, (job.number + 1) * SHARD):
        start = starts.draw(index)
        starts.put(start)
        end = hold(starts.scene)
        reasons.append(1 + REASONS.index(end.reason) if end.reason else 0)
        if not end.reason:
            rows.append((end, start))
    scene = starts.scene

    def column(values: list[Any], width: int) -> FloatArray:
        return np.array(values, dtype=np.float64).reshape(len(rows), width)

    return Shard(
        reason=np.array(reasons),
        q=column([end.q for end, _ in rows], len(scene.qpos)),
        commands=column([start.commands for _, start in rows], len(scene.ctrl)),
        position=column([end.position for end, _ in rows], 3),
        quaternion=column([end.quaternion for end, _ in rows], 4),
        gravity=column([start.gravity for _, start in rows], 3),
        mass=column([start.mass for _, start in rows], 1)[:, 0],
        friction=column([start.friction for _, start in rows], 1)[:, 0],
        source=np.array([start.source for _, start in rows], dtype=np.int64),
        cpu_s=time.process_time() - begin,
    )


def read_shard(folder: Path, number: int) -> Shard | None:
    """A shard from its file; None where that is missing or damaged."""
    path = shard_path(folder, number)
    try:
        # numpy.load leaves a damaged file open that it opened itself
        with path.open("rb") as stream, np.load(stream) as file:
            content = {name: file[name] for name in file.files}
        return Shard(**content | {"cpu_s": float(content["cpu_s"])})
    except (OSError, ValueError, TypeError, KeyError, EOFError, zipfile.BadZipFile):
        return None


MANIFEST, SUMMARY, CHECK_FILE = "manifest.json", "summary.json", "check_states.py"
"""Files in the root of a cache."""

FORMAT, VERSION = "opposable-states-cache", 1

JOURNAL = "sources.jsonl"


@contextmanager
def open_folder(folder: Path, asked: StatesAsked, hand_digest: str) -> Iterator[None]:
    """Begin a cache, or go on with one; within the block no other process writes to it.

    Args:
        folder: Its folder.
        asked: What is asked for. More states than last time may be, nothing else may differ.
        hand_digest: Digest of the hand's files.

    Raises:
        FileFormatError: The folder holds another cache or something else, or another process is
            writing to it.
    """
    _begin(folder, asked, hand_digest)
    lock = lock_folder(folder, "states")
    try:
        yield
    finally:
        os.close(lock)


def _begin(folder: Path, asked: StatesAsked, hand_digest: str) -> None:
    path = folder / MANIFEST
    wanted = {"format": FORMAT, "version": VERSION, "hand_sha256": hand_digest, **asked.to_dict()}
    if path.exists():
        there = read_json(path, "a cache of states")
        there.pop("written_by", None)
        if there.get("format") != FORMAT:
            raise FileFormatError(
                f"{folder} holds something else, of the format {shown(there.get('format'))}; "
                "choose another folder"
            )
        refuse_other_request(folder, "cache of states", there, wanted)
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if any(folder.iterdir()):
            raise FileFormatError(f"{folder} is not empty and holds no {MANIFEST}; choose another")
        copyfile(Path(__file__).with_name(CHECK_FILE), folder / CHECK_FILE)
    except OSError as error:
        raise FileFormatError(
            f"cannot begin a cache in {folder}: {error.strerror}; choose another folder"
        ) from error
    write_json({**wanted, "written_by": written_by()}, path)


def journal(folder: Path) -> dict[str, Mapping[str, Any]]:
    """Plans of a cell that were made, by their key; half a line, left by a kill, is skipped."""
    plans = read_json_lines(folder / WORK / JOURNAL)
    return {plan["key"]: plan for plan in plans if isinstance(plan.get("key"), str)}


BANDS, SECTORS, TURNS = 6, 12, 12
"""Cells along z, around z, and of the turn about the direction."""


def direction_cells(directions: FloatArray) -> IntArray:
    """Cells (m,), 0 to 71, of unit vectors (m, 3)."""
    band = np.clip(np.floor((directions[:, 2] + 1.0) / 2.0 * BANDS), 0, BANDS - 1)
    around = np.arctan2(directions[:, 1], directions[:, 0]) / (2.0 * np.pi) % 1.0
    sector = np.clip(np.floor(around * SECTORS), 0, SECTORS - 1)
    return np.asarray(band * SECTORS + sector, dtype=np.int64)


def orientation_cells(rotations: FloatArray) -> IntArray:
    """Cells (m,), 0 to 863, of rotation matrices (m, 3, 3)."""
    u = rotations[:, :, 2]
    # the shortest rotation takes e_x to a vector that the formula gives away from u = -e_z
    below = np.maximum(1.0 + u[:, 2], 1e-12)
    first = np.stack([1.0 - u[:, 0] ** 2 / below, -u[:, 0] * u[:, 1] / below, -u[:, 0]], axis=1)
    second = np.cross(u, first)
    x = rotations[:, :, 0]
    psi = np.arctan2((x * second).sum(axis=1), (x * first).sum(axis=1)) / (2.0 * np.pi) % 1.0
    step = np.clip(np.floor(psi * TURNS), 0, TURNS - 1).astype(np.int64)
    return np.asarray(direction_cells(u) * TURNS + step, dtype=np.int64)


def coverage(rotations: FloatArray, gravity: FloatArray) -> dict[str, Any]:
    """How many cells states reach, as plain data.

    Args:
        rotations: Orientations of the object in the palm (m, 3, 3).
        gravity: Directions of gravity in the palm (m, 3), any length.
    """
    down = gravity / np.linalg.norm(gravity, axis=1, keepdims=True)
    return {
        "orientations_of_object_in_palm": _counts(
            orientation_cells(rotations), BANDS * SECTORS * TURNS
        ),
        "directions_of_object_axis_in_palm": _counts(
            direction_cells(rotations[:, :, 2]), BANDS * SECTORS
        ),
        "directions_of_gravity_in_palm": _counts(direction_cells(down), BANDS * SECTORS),
    }


def _counts(cells: IntArray, total: int) -> dict[str, Any]:
    """Cells reached, of how many, and the states in a cell that is reached: median and most."""
    counts = np.bincount(cells, minlength=total)
    reached = counts[counts > 0]
    return {
        "cells": total,
        "reached": len(reached),
        "share": len(reached) / total,
        "median_states_in_a_reached_cell": float(np.median(reached)) if len(reached) else 0.0,
        "most_states_in_a_cell": int(counts.max()),
    }


NEAR_POSITION, NEAR_ANGLE, NEAR_JOINT = 0.001, float(np.deg2rad(1.0)), float(np.deg2rad(1.0))
"""Tolerances: m, rad, rad (m for slides)."""


class Distinct:
    """States that were taken, and the question whether another one is new.

    They are filed by the cube of 1 mm that the object's position falls into, so that a state is
    compared with those of 27 cubes.
    """

    def __init__(self) -> None:
        """Nothing was taken."""
        self._cubes: dict[tuple[int, int, int], list[int]] = {}
        self._rows: list[FloatArray] = []

    def take(self, q: FloatArray, position: FloatArray, quaternion: FloatArray) -> bool:
        """Take a state if it is new; whether it is.

        Args:
            q: Joints (nq,).
            position: Of the object (3,), m.
            quaternion: Its orientation, a unit quaternion (4,).
        """
        x, y, z = (int(i) for i in np.floor(position / NEAR_POSITION))
        near = [
            i
            for dx in (-1, 0, 1)
            for dy in (-1, 0, 1)
            for dz in (-1, 0, 1)
            for i in self._cubes.get((x + dx, y + dy, z + dz), ())
        ]
        row = np.concatenate([position, quaternion, q])
        if near and _near(np.array([self._rows[i] for i in near]), row).size:
            return False
        self._cubes.setdefault((x, y, z), []).append(len(self._rows))
        self._rows.append(row)
        return True


def _near(others: FloatArray, row: FloatArray) -> IntArray:
    """Which rows (m, 7 + nq) are near-duplicates of a row."""
    apart = np.linalg.norm(others[:, :3] - row[:3], axis=1) <= NEAR_POSITION
    apart &= np.abs(others[:, 3:7] @ row[3:7]) >= np.cos(NEAR_ANGLE / 2)
    apart &= np.abs(others[:, 7:] - row[7:]).max(axis=1) <= NEAR_JOINT
    return np.flatnonzero(apart)
