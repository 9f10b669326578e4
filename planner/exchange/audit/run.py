"""``audit_grasps``, ``audit_plans``, ``audit_file``: all grasps of a source, on all cores."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

from planner.batch.pool import default_backend, end_with, finished
from planner.batch.recipe import recipe_of, task_of
from planner.errors import PlannerError, TaskError
from planner.exchange.audit.grasp_file import (
    GraspFile,
    need_one_object,
    plans_as_imported,
    right_task,
)
from planner.exchange.audit.judge import Judge
from planner.exchange.audit.report import AuditReport, AuditRow, StageResult, joined_reports
from planner.exchange.formats import ImportedGrasp, ImportedGrasps, Reading
from planner.hands.hand import Hand
from planner.plan import GraspPlan
from planner.task import GraspTask

FEW, FEW_EXECUTED = 1000, 20
"""Grasps, without and with execution, up to which several processes do not pay: each takes 4 s of
CPU to load libraries and models, a verdict 3 to 10 ms, an execution 0.2 s."""

AT_ONCE = 16
"""Grasps of a job: one takes some milliseconds, a message a part of one."""

Progress = Callable[[AuditRow], object]
Execute = Callable[[GraspTask, ImportedGrasp], StageResult]


@dataclass(frozen=True, kw_only=True)
class AuditJob:
    """Some grasps, as they are sent to a worker.

    Attributes:
        recipe: Their task as text (``planner.batch.recipe``).
        told: Whether the task's fingers hold and no others.
        approach: Whether the way in is judged.
        first: Place of the first in its file.
        source: The file.
        grasps: The grasps.
        execute: What adds the stage "held"; None to leave it out.
        parent: Process that started it.
    """

    recipe: str
    told: bool
    approach: bool
    first: int
    source: str
    grasps: tuple[ImportedGrasp, ...]
    execute: Execute | None
    parent: int


def audit_grasps(
    task: GraspTask,
    given: ImportedGrasps,
    *,
    fixed_fingers: bool = False,
    approach: bool = False,
    execute: Execute | None = None,
    workers: int = 1,
    progress: Progress | None = None,
) -> AuditReport:
    """The verdict on grasps of one hand and object, by the code that judges our own plans.

    Ctrl-C keeps the rows that are there: the report is not ``complete``.

    Args:
        task: Hand, object in the size of scale 1, friction, grip, gravity, table. Where a grasp
            says how its object stands, that counts and not ``task.T_world_object``.
        given: The grasps.
        fixed_fingers: Whether the fingers of the task hold and no others; else they are found.
        approach: Whether a straight way in is asked for too.
        execute: Executes a grasp and says whether it held; adds the stage "held".
        workers: Processes at most; -1 for one per core. Few grasps are judged here; several
            processes need a hand that a file can name.
        progress: Called with every row as it is there.

    Raises:
        TaskError: There is no grasp, or the number of workers is none.
    """
    if not len(given):
        raise TaskError(f"{given.source} holds no grasp; there is nothing to judge")
    rows: list[AuditRow] = []
    try:
        for some in _chunks(task, given, fixed_fingers, approach, execute, workers):
            rows += some
            for row in some:
                if progress is not None:
                    progress(row)
    except KeyboardInterrupt:
        pass  # the report says that it is not complete
    assumed = list(given.assumed)
    if any(g.T_world_object is None for g in given.grasps) and task.gravity.any():
        assumed.append("the object stands as the task has it where the file does not say how")
    return AuditReport(
        source=str(given.source),
        format=given.format,
        hand=task.hand.name,
        object=task.object.shape.spec,
        rows=tuple(sorted(rows, key=lambda row: row.index)),
        total=len(given),
        assumed=tuple(assumed),
    )


def audit_plans(
    plans: Sequence[GraspPlan],
    source: Path,
    *,
    approach: bool = False,
    progress: Progress | None = None,
) -> AuditReport:
    """The same of our own plans, each with the fingers and the surroundings of its task.

    Args:
        plans: The plans.
        source: Where they are from.
        approach: Whether a straight way in is asked for too.
        progress: Called with every row.

    Raises:
        TaskError: There is no plan.
    """
    reports = [
        audit_grasps(task, given, fixed_fingers=True, approach=approach, progress=progress)
        for task, given in plans_as_imported(plans, source)
    ]
    joined = joined_reports(reports)
    rows = tuple(replace(row, index=i) for i, row in enumerate(joined.rows))
    return replace(joined, rows=rows)


def audit_file(
    path: Path,
    task_for: Callable[[Hand], GraspTask],
    hand: Hand,
    *,
    format: str | None = None,
    reading: Reading | None = None,
    only: str = "",
    fixed_fingers: bool = False,
    approach: bool = False,
    execute: Execute | None = None,
    workers: int = 1,
    started: Callable[[ImportedGrasps], object] | None = None,
    progress: Progress | None = None,
) -> AuditReport:
    """The verdict on the grasps of a file.

    Args:
        path: The file or folder.
        task_for: Makes the task for a hand.
        hand: The hand.
        format: Name of the format; that which the file looks like if None.
        reading: What the file does not say.
        only: Only grasps whose object's name holds this text.
        fixed_fingers: As in ``audit_grasps``.
        approach: As in ``audit_grasps``.
        execute: As in ``audit_grasps``.
        workers: As in ``audit_grasps``.
        started: Called with the grasps before they are judged.
        progress: Called with every row.

    Raises:
        FileFormatError: Damaged, of several objects, or read in another unit, order or hand than
            it was written.
        NotFoundError: No such file or format.
        TaskError: The format has no reader.
    """
    file = GraspFile.open(path, format=format, reading=reading, only=only)
    need_one_object(path, sorted({g.object for g in file.grasps(hand).grasps}))
    task, given = right_task(file, task_for, hand, fixed_fingers=fixed_fingers)
    if started is not None:
        started(given)
    return audit_grasps(
        task,
        given,
        fixed_fingers=fixed_fingers,
        approach=approach,
        execute=execute,
        workers=workers,
        progress=progress,
    )


def _chunks(
    task: GraspTask,
    given: ImportedGrasps,
    told: bool,
    approach: bool,
    execute: Execute | None,
    workers: int,
) -> Iterator[list[AuditRow]]:
    """Rows, some at a time."""
    if workers == 1 or len(given) <= (FEW if execute is None else FEW_EXECUTED):
        judge = Judge(task, fixed_fingers=told, approach=approach)
        for i, grasp in enumerate(given.grasps):
            yield [_judged(judge, grasp, i, str(given.source), execute)]
        return
    recipe = recipe_of(task)
    jobs = (
        AuditJob(
            recipe=recipe,
            told=told,
            approach=approach,
            first=first,
            source=str(given.source),
            grasps=given.grasps[first : first + AT_ONCE],
            execute=execute,
            parent=os.getpid(),
        )
        for first in range(0, len(given), AT_ONCE)
    )
    yield from finished(
        _work, jobs, workers=workers, backend=default_backend(workers), given_up=_given_up
    )


def _work(job: AuditJob) -> list[AuditRow]:
    """Judge some grasps, in a worker."""
    end_with(job.parent)
    judge = _judge_of(job.recipe, job.told, job.approach)
    return [
        _judged(judge, grasp, job.first + i, job.source, job.execute)
        for i, grasp in enumerate(job.grasps)
    ]


@lru_cache(maxsize=2)
def _judge_of(recipe: str, told: bool, approach: bool) -> Judge:
    return Judge(task_of(recipe), fixed_fingers=told, approach=approach)


def _judged(
    judge: Judge, grasp: ImportedGrasp, index: int, source: str, execute: Execute | None
) -> AuditRow:
    """The row of a grasp, also where it comes to no verdict."""
    try:
        row = judge.row(grasp, index, source)
        if execute is None:
            return row
        held = execute(judge.task_of(grasp, row.fingers), grasp)
    except PlannerError as error:
        return _not_judged(grasp, index, source, str(error))
    return replace(row, stages={**row.stages, "held": held})


def _given_up(job: AuditJob, reason: str) -> list[AuditRow]:
    """Rows of grasps whose process died."""
    return [_not_judged(g, job.first + i, job.source, reason) for i, g in enumerate(job.grasps)]


def _not_judged(grasp: ImportedGrasp, index: int, source: str, reason: str) -> AuditRow:
    stages = {"joints": StageResult(passed=None, reason=reason)}
    return AuditRow(index=index, name=grasp.name, source=source, stages=stages)
