"""Shards: 64 candidates each, held by workers, kept as one file each that appears whole.

A shard's content is a function of the seed, the cell and its number. So a run that was interrupted
goes on with the shards that are missing, and any number of workers gives the same states.
"""

from __future__ import annotations

import os
import signal
import time
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from planner.batch.jobs import end_with
from planner.files.whole import whole_file
from planner.spatial import FloatArray, IntArray
from sim.reset_states.hold import REASONS, hold
from sim.reset_states.starts import WORK, load_starts

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
