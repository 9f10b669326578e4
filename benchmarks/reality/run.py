"""``run_reality``: the trials of the comparison, a row each.

Trial k of a task and a hand has object k modulo their number and the draw k over it. Its number in
the file follows from what is run: hand, object, draw, errors and driver. So the file goes on with
more trials, hands, tasks, realities and loops; a preset that is changed begins new rows; and two
loops that are told the same, as truth and readings in the ideal reality, are run once.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, ClassVar

from benchmarks.reality.cells import cells_of, numbers_of
from benchmarks.reality.loops import Loop, named_loop
from benchmarks.reality.tasks import named_task
from benchmarks.requests import loaded_hand
from benchmarks.run import Job, measure
from planner.errors import HandError, PlannerError, TaskError
from sim.reality import Reality
from sim.runner import Check, Runner
from sim.tables import Row

FORMAT = "opposable-bench-reality"

BITS = 52
"""Size of a row's number: an integer that JSON keeps; two of 10^4 trials agree once in 10^8."""


@dataclass(frozen=True, kw_only=True)
class ComparedTrial(Job):
    """One trial of one loop.

    A row names the loop that ran it; another one that is told the same has the same row.

    Attributes:
        task: Name out of ``TASKS``.
        hand: Name or path.
        kind: The object.
        draw: Number of the draw, and seed of planning and reality.
        reality: As it is named on the command line.
        loop: Name out of ``LOOPS``.
        estimator: What tells that loop where the object is, a name out of ``sim.estimation``.
    """

    SHOWN: ClassVar = ("task", "hand", "kind", "draw", "loop", "estimator")

    task: str
    hand: str
    kind: str
    draw: int
    reality: Reality
    loop: str
    estimator: str

    def row(self, **values: Any) -> Row:
        """The row, with the name of the reality: its numbers stand in the result."""
        return super().row(reality=self.reality.name, **values)

    @property
    def cell(self) -> tuple[str, str, str, str, str]:
        """Its name, as ``cells.CELL`` says."""
        return self.task, self.reality.name, self.loop, self.hand, self.kind


def compared_trials(
    hands: Sequence[str],
    tasks: Sequence[str],
    realities: Sequence[Reality],
    loops: Sequence[Loop],
    n: int,
    seed: int,
    objects_only: Sequence[str] = (),
) -> list[ComparedTrial]:
    """All trials, those of one draw one after the other, so that a plan serves them all."""
    trials = []
    for k in range(n):
        for task in tasks:
            objects = named_task(task).only(objects_only)
            kind, draw = objects[k % len(objects)], seed + k // len(objects)
            for hand in hands:
                for reality in realities:
                    for loop in loops:
                        if not loop.does(task):
                            continue
                        trial = ComparedTrial(
                            index=_number(task, hand, kind, draw, loop, reality),
                            task=task,
                            hand=hand,
                            kind=kind,
                            draw=draw,
                            reality=reality,
                            loop=loop.name,
                            estimator=loop.estimator,
                        )
                        trials.append(trial)
    return trials


def compared_row(trial: ComparedTrial, check: Check) -> Row:
    """Plan and execute a trial: a row of plain data."""
    task, loop = named_task(trial.task), named_loop(trial.loop)
    # realities with the same encoders have the same plans
    known = Reality(encoder_offset=trial.reality.encoder_offset)
    plan, planning_cpu_s = _planned(trial.task, trial.hand, trial.kind, trial.draw, known)
    check()
    told = {"driver": loop.driver, "planning_cpu_s": planning_cpu_s}
    if isinstance(plan, str):
        return trial.row(planned=False, success=False, reason="no plan", detail=plan, **told)
    reality = loop.told(trial.reality).seeded(trial.draw)
    begin = time.process_time()
    try:
        came = task.execute(trial.hand, trial.kind, trial.draw, plan, loop, reality)
    except HandError as error:  # a policy of another hand
        return trial.row(planned=True, success=False, reason="refused", detail=str(error), **told)
    cpu_s = time.process_time() - begin
    check()
    return trial.row(planned=True, read=reality.name, simulation_cpu_s=cpu_s, **told, **came)


def run_reality(
    hands: Sequence[str],
    n: int,
    *,
    tasks: Sequence[str],
    realities: Sequence[Reality],
    loops: Sequence[str],
    seed: int,
    file: Path,
    runner: Runner,
    objects: Sequence[str] = (),
) -> Row:
    """Run the trials that the file does not have yet.

    Args:
        hands: Names or paths.
        n: Trials of each hand, task, reality and loop.
        tasks: Names out of ``TASKS``.
        realities: How far off everything is.
        loops: Names out of ``LOOPS``.
        seed: First draw.
        file: Of the rows; made if it is not there.
        runner: Who works on them.
        objects: Which of the tasks' objects take turns; all if empty.

    Returns:
        Plain data: what it was made with, and counts per cell, without the rows.

    Raises:
        FileFormatError: The file is not one of these, or cannot be written.
        NotFoundError: A hand, a task, a loop or an object of a task that does not exist.
        TaskError: A loop that cannot run here, two realities of one name, or nothing that is asked
            for can be done.
    """
    for hand in hands:
        loaded_hand(hand)
    for name, count in Counter(reality.name for reality in set(realities)).items():
        if count > 1:
            raise TaskError(f"{count} realities are called {name!r}; give each a name of its own")
    columns = [named_loop(name) for name in loops]
    trials = compared_trials(hands, tasks, realities, columns, n, seed, objects)
    if not trials:
        raise TaskError(
            f"no trial to run: {', '.join(loops)} cannot do {', '.join(tasks)}; name another loop"
        )
    once = {trial.index: trial for trial in reversed(trials)}
    jobs = [trial for trial in trials if once[trial.index] is trial]
    result = measure(
        runner,
        compared_row,
        jobs,
        kind=FORMAT,
        title="compare",
        lost=_lost,
        file=file,
        asked={"format": f"{FORMAT}-rows", "version": 1},
        n=n,
        hands=list(hands),
        seed=seed,
        tasks={name: named_task(name).about for name in tasks},
        realities=[reality.to_dict() for reality in realities],
        loops={loop.name: loop.about for loop in columns},
    )
    rows = {row["index"]: row for row in result.pop("rows")}
    found = [(t.cell, rows[t.index]) for t in trials if t.index in rows]
    return result | {"cells": cells_of(found), "numbers": numbers_of(found)}


def _lost(trial: ComparedTrial, reason: str) -> Row:
    """The row of a trial that killed every process that tried it."""
    return trial.row(planned=False, success=False, reason="process died", detail=reason)


@lru_cache(maxsize=2)
def _planned(task: str, hand: str, kind: str, draw: int, known: Reality) -> tuple[Any, float]:
    """A plan, or why there is none, and its CPU time, s; made once for the loops that follow."""
    begin = time.process_time()
    try:
        plan: Any = named_task(task).plan(hand, kind, draw, known)
    except PlannerError as error:
        plan = str(error)
    return plan, time.process_time() - begin


def _number(task: str, hand: str, kind: str, draw: int, loop: Loop, reality: Reality) -> int:
    """The number of a row: what is run, and nothing else, decides it."""
    told = loop.told(reality)
    off = {name: value for name, value in told.numbers.items() if value}
    what = [
        task,
        hand,
        kind,
        draw,
        loop.driver,
        loop.estimator,
        None if told.ideal else off,
    ]
    if reality.encoder_offset:
        what.append(reality.encoder_offset)  # planning reckons with it, whatever a loop is told
    digest = hashlib.blake2b(json.dumps(what).encode(), digest_size=8).digest()
    return int.from_bytes(digest) >> (64 - BITS)
