"""``make_states``: plan, hold, keep what is distinct, write; resumable, on all cores."""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from planner.batch.pool import check_backend, default_backend, finished
from planner.errors import FileFormatError, TaskError
from planner.files import write_json
from planner.files.disk import Journal
from planner.hands.hand import Hand
from planner.kinematics import HandState
from planner.spatial import FloatArray, pose_from_wxyz
from planner.system.package import written_by
from planner.task import GraspTask
from sim.datasets.reset_states.formats import STATES_FILE, StateSet, state_format, state_formats
from sim.datasets.reset_states.hold import REASONS, SCENE_FILE, write_scene
from sim.datasets.reset_states.shards import (
    JOURNAL,
    SHARD,
    SUMMARY,
    Distinct,
    Shard,
    ShardJob,
    coverage,
    held_shard,
    journal,
    open_folder,
    read_shard,
    shard_path,
)
from sim.datasets.reset_states.starts import (
    WORK,
    Cell,
    PlanJob,
    StatesAsked,
    cells_of,
    load_starts,
    plan_jobs,
    planned_sources,
    rows_of,
    write_cell,
)

ALL = "all"
"""Every format that can hold the states."""

DUPLICATE = "near-duplicate of an earlier state"

MOST_TRIES = 20
"""Candidates per state that is asked for; where they do not give enough, fewer are kept."""


@dataclass(frozen=True, kw_only=True)
class StatesProgress:
    """How far a run is.

    Attributes:
        cell: Name of the object and size at work.
        phase: "planning" or "holding".
        done: Plans made, or states kept.
        total: Plans or states that are asked for.
        before: Those of ``done`` that earlier runs left.
        tried: Candidates held so far.
        elapsed_s: Time since the phase began, s.
    """

    cell: str
    phase: str
    done: int
    total: int
    before: int
    tried: int
    elapsed_s: float


Report = Callable[[StatesProgress], None]


def make_states(
    asked: StatesAsked,
    folder: Path | str,
    *,
    workers: int = -1,
    formats: Sequence[str] = (ALL,),
    progress: Report | None = None,
) -> dict[str, Any]:
    """Make a cache of stable states, or go on with one.

    Args:
        asked: What is asked for. The states depend on it alone.
        folder: Of the cache; one of the same request goes on, also with a larger n. With a smaller
            one it keeps the states that it has.
        workers: Processes; -1 for one per core, 1 for this one.
        formats: Names of formats; "all" for those that can hold the states.
        progress: Called at the beginning of a phase and after every plan or shard.

    Returns:
        The content of ``summary.json``: per object and size what was planned, the rate kept, the
        reasons of those lost, coverage, files.

    Raises:
        PlannerError: Bad input; a folder with another cache; a format that was named and cannot
            hold the states.
        KeyboardInterrupt: Ctrl-C; whole plans and shards are kept, and the same call goes on.
    """
    for name in formats:
        if name != ALL:
            state_format(name)
    check_backend(default_backend(workers), workers)
    hand, cells = cells_of(asked)
    root = Path(folder)
    tell = progress or (lambda _: None)
    with open_folder(root, asked, hand.digest):
        summary = {
            "format": "opposable-states-summary",
            "version": 1,
            "written_by": written_by(),
            "hand": hand.name,
            "physics": str(asked.physics),
            "cells": [
                _make_cell(asked, hand, cell, task, root, workers, formats, tell)
                for cell, task in cells
            ],
        }
        write_json(summary, root / SUMMARY)
    return summary


def _make_cell(
    asked: StatesAsked,
    hand: Hand,
    cell: Cell,
    task: GraspTask,
    root: Path,
    workers: int,
    formats: Sequence[str],
    tell: Report,
) -> dict[str, Any]:
    """Plan, hold and write one cell; what the summary says of it."""
    folder = root / cell.name
    if not (folder / SCENE_FILE).exists():
        write_scene(task, asked.physics, folder)
    before = _there(folder)
    n = max(asked.n, before)
    plans = _planned(asked, cell, folder, workers, tell)
    sources = [source for plan in plans for source in plan["sources"]]
    about: dict[str, Any] = {
        "name": cell.name,
        "object": cell.object,
        "scale": cell.scale,
        "asked": asked.n,
        "before": before,
        "plans": _plan_counts(plans),
        "sources": len(sources),
    }
    if not sources:
        return about | {"states": 0, "tried": 0, "lost": {}, "files": {}, "left_out": {}}
    write_cell(asked, cell, hand, sources, folder)
    load_starts.cache_clear()
    kept = _Kept(n)
    begin, cpu_s, tried = time.monotonic(), 0.0, 0
    held_before: int | None = None
    for made_now, shard in _shards(folder, kept, n, workers):
        if made_now and held_before is None:
            held_before, begin = len(kept.rows), time.monotonic()
        kept.add(shard)
        cpu_s += shard.cpu_s
        tried += SHARD
        tell(
            StatesProgress(
                cell=cell.name,
                phase="holding",
                done=len(kept.rows),
                total=n,
                before=len(kept.rows) if held_before is None else held_before,
                tried=kept.tried,
                elapsed_s=time.monotonic() - begin,
            )
        )
    about |= {
        "states": len(kept.rows),
        "tried": kept.tried,
        "rate_kept": len(kept.rows) / kept.tried,
        "lost": dict(kept.lost.most_common()),
        "hold_cpu_s_per_state": cpu_s / tried * kept.tried / max(1, len(kept.rows)),
    }
    if not kept.rows:
        return about | {"files": {}, "left_out": {}}
    states = kept.states(hand, cell, load_starts(folder).sources)
    files, left_out = _write(states, cell.name, root, formats)
    kinds = Counter(states.kind.tolist())
    about |= {"states_by_kind": dict(kinds.most_common())}
    return about | {"coverage": _coverage(hand, states), "files": files, "left_out": left_out}


def _there(folder: Path) -> int:
    """How many states of a cell an earlier run has written; 0 where its file is damaged."""
    path = folder / STATES_FILE
    try:
        return len(StateSet.read(path)) if path.exists() else 0
    except FileFormatError:
        return 0


def _planned(
    asked: StatesAsked, cell: Cell, folder: Path, workers: int, tell: Report
) -> list[dict[str, Any]]:
    """The plans of a cell in the order of their jobs, those that are missing made now."""
    jobs = list(plan_jobs(asked, cell))
    made = dict(journal(folder))
    missing = [job for job in jobs if job.key not in made]
    begin, before = time.monotonic(), len(jobs) - len(missing)

    def report() -> None:
        tell(
            StatesProgress(
                cell=cell.name,
                phase="planning",
                done=sum(job.key in made for job in jobs),
                total=len(jobs),
                before=before,
                tried=0,
                elapsed_s=time.monotonic() - begin,
            )
        )

    report()
    if missing:
        results = finished(
            planned_sources,
            missing,
            workers=workers,
            backend=default_backend(workers),
            given_up=_no_plan,
        )
        (folder / WORK).mkdir(parents=True, exist_ok=True)
        with Journal(folder / WORK / JOURNAL) as lines:
            for plan in results:
                lines.add(plan)
                made[plan["key"]] = plan
                report()
    return [dict(made[job.key]) for job in jobs]


def _no_plan(job: PlanJob, reason: str) -> dict[str, Any]:
    return {"key": job.key, "reason": reason, "sources": []}


def _plan_counts(plans: list[dict[str, Any]]) -> dict[str, Any]:
    """Plans that are asked for and found, and their poses, by kind; the reasons of the others."""
    counts: dict[str, Any] = {}
    reasons: Counter[str] = Counter()
    for plan in plans:
        kind = counts.setdefault(plan["key"].split()[0], {"asked": 0, "found": 0, "poses": 0})
        kind["asked"] += 1
        kind["found"] += bool(plan["sources"])
        kind["poses"] += len(plan["sources"])
        if plan["reason"]:
            reasons[plan["reason"]] += 1
    return counts | {"reasons": dict(reasons.most_common())}


def _shards(folder: Path, kept: _Kept, n: int, workers: int) -> Iterator[tuple[bool, Shard]]:
    """Shards in order, until enough is kept: whether each was made now, and its content.

    Workers may finish them in another order; those that come early wait.
    """
    most = -(-n * MOST_TRIES // SHARD)
    number = 0
    while number < most and not kept.enough and (shard := read_shard(folder, number)) is not None:
        yield False, shard
        number += 1
    if number == most or kept.enough:
        return
    shard_path(folder, 0).parent.mkdir(parents=True, exist_ok=True)
    waiting: dict[int, Shard] = {}
    first = number

    def jobs() -> Iterator[ShardJob]:
        for k in range(first, most):
            if kept.enough:
                return
            there = read_shard(folder, k)
            if there is None:
                yield ShardJob(folder=folder.resolve(), number=k, parent=os.getpid())
            else:
                waiting[k] = there

    results = finished(
        held_shard, jobs(), workers=workers, backend=default_backend(workers), given_up=_dead_shard
    )
    for k, shard in results:
        waiting[k] = shard
        while number in waiting and not kept.enough:
            yield True, waiting.pop(number)
            number += 1
    while number in waiting and not kept.enough:
        yield True, waiting.pop(number)
        number += 1


def _dead_shard(job: ShardJob, reason: str) -> tuple[int, Shard]:
    raise TaskError(f"shard {job.number} of {job.folder} cannot be held: {reason}")


class _Kept:
    """States in the order of their candidates, near-duplicates left out, up to n."""

    def __init__(self, n: int) -> None:
        self._n = n
        self._distinct = Distinct()
        self.rows: list[tuple[Shard, int]] = []
        self.lost: Counter[str] = Counter()
        self.tried = 0

    @property
    def enough(self) -> bool:
        """Whether there are n."""
        return len(self.rows) >= self._n

    def add(self, shard: Shard) -> None:
        """Take what is new of the next shard."""
        row = 0
        for reason in shard.reason.tolist():
            if self.enough:
                return
            self.tried += 1
            if reason:
                self.lost[REASONS[reason - 1]] += 1
                continue
            state = shard.q[row], shard.position[row], shard.quaternion[row]
            if self._distinct.take(*state):
                self.rows.append((shard, row))
            else:
                self.lost[DUPLICATE] += 1
            row += 1

    def states(self, hand: Hand, cell: Cell, sources: dict[str, Any]) -> StateSet:
        """All of them."""

        def column(name: str) -> Any:
            return np.array([getattr(shard, name)[row] for shard, row in self.rows])

        q, commands, moment = column("q"), column("commands"), hand.actuation.moment
        return StateSet(
            hand=hand.name,
            object=cell.object,
            scene=SCENE_FILE,
            scale=cell.scale,
            joint_names=hand.joint_names,
            actuator_names=hand.actuation.names,
            q=q,
            commands=commands,
            targets=q + (commands - q @ moment.T) @ np.linalg.pinv(moment).T,
            position=column("position"),
            quaternion=column("quaternion"),
            gravity=column("gravity"),
            mass=column("mass"),
            friction=column("friction"),
            **rows_of(sources, column("source")),
        )


def _write(
    states: StateSet, name: str, root: Path, formats: Sequence[str]
) -> tuple[dict[str, str], dict[str, str]]:
    """Write states in formats: the files, relative to the root, and why others were left out.

    Raises:
        TaskError: A format that was named cannot hold them.
    """
    files: dict[str, str] = {}
    left_out: dict[str, str] = {}
    for known in state_formats():
        # the check of a cache reads npz
        if not (known in formats or ALL in formats or known == "npz"):
            continue
        chosen = state_format(known)
        if reason := chosen.refuses(states):
            if known in formats:
                raise TaskError(f"no {known} of {name}: {reason}")
            left_out[known] = reason
            continue
        files[known] = str(chosen.write(states, name, root).relative_to(root))
    return files, left_out


def _coverage(hand: Hand, states: StateSet) -> dict[str, Any]:
    """Coverage of the orientations of object and gravity in the palm."""
    wrist = hand.wrist_index.size > 0
    palm = HandState(hand, states.q[0]).T_base_palm.rotation
    rotations, down = [], []
    for q, position, quaternion, gravity in zip(
        states.q, states.position, states.quaternion, states.gravity, strict=True
    ):
        if wrist:
            palm = HandState(hand, q).T_base_palm.rotation
        rotations.append(palm.T @ pose_from_wxyz(position, quaternion).rotation)
        down.append(palm.T @ gravity)
    stacked: FloatArray = np.array(rotations)
    return coverage(stacked, np.array(down))
