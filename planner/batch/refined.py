"""``refine_grasps``: many given hand poses brought to grasps, here or in processes, as they come.

Workers make the task from its text (``planner.batch.recipe``). A result comes back pickled with the
fingers in place of its task, since hands cannot be sent; here it gets the caller's own task again.
"""

from __future__ import annotations

import io
import os
import pickle
import signal
from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from functools import partial
from typing import Any

from planner.batch.pool import check_backend, default_backend, end_with, finished
from planner.batch.recipe import recipe_of, task_of
from planner.errors import PlannerError, TaskError
from planner.failure import Failure
from planner.search.refine import RefinedGrasp, refine_grasp, with_fingers
from planner.spatial import SE3, FloatArray
from planner.synthesis.options import SynthesisOptions
from planner.system.threads import on_interrupt
from planner.task import GraspTask

AT_ONCE = 8
"""Poses per message to a worker: some 0.1 s of work."""

Pose = tuple[SE3, FloatArray]
Result = tuple[int, RefinedGrasp]


def refine_grasps(
    task: GraspTask | Sequence[GraspTask],
    poses: Sequence[Pose],
    *,
    clamp: bool = False,
    options: SynthesisOptions | None = None,
    workers: int = 1,
    backend: str | None = None,
) -> Iterator[Result]:
    """Number and result of each pose, as they are finished; each is that of ``refine_grasp``.

    Take results as they come, and stop whenever that is enough: what was taken is there, whatever
    happens next. ``dict(refine_grasps(...))`` takes all. A pose that ``refine_grasp`` would refuse,
    with NaN for instance, becomes a result with the failure ``bad_pose``, and the others go on.

    Args:
        task: The task, or one for every pose.
        poses: Base pose and joints (nq,) of each.
        clamp: As in ``refine_grasp``.
        options: As in ``refine_grasp``.
        workers: Processes; 1 for this one, in order of the poses; -1 for one per core.
        backend: As in ``plan_grasps``.

    Raises:
        TaskError: Not as many tasks as poses, or no backend or number of workers; with several
            workers, a hand that was made in Python.
    """
    tasks = [task] * len(poses) if isinstance(task, GraspTask) else list(task)
    if len(tasks) != len(poses):
        raise TaskError(f"there are {len(tasks)} tasks for {len(poses)} poses; give one for each")
    backend = default_backend(workers) if backend is None else backend
    check_backend(backend, workers)
    if workers == 1:
        return (
            (index, _refined(task, *pose, clamp, options))
            for index, (task, pose) in enumerate(zip(tasks, poses, strict=True))
        )
    jobs = _jobs(tasks, poses, clamp, options)
    return _by_workers(jobs, tasks, workers, backend)


def _refined(
    task: GraspTask,
    T_world_base: SE3,
    q: FloatArray,
    clamp: bool,
    options: SynthesisOptions | None,
) -> RefinedGrasp:
    """The result of one pose, also where it is refused."""
    try:
        return refine_grasp(task, T_world_base, q, clamp=clamp, options=options)
    except PlannerError as error:
        return RefinedGrasp.untried(
            task, T_world_base, q, Failure(kind="bad_pose", text=f"bad pose: {error}")
        )


@dataclass(frozen=True, kw_only=True)
class _Job:
    """Some poses of one task, as they are sent to a worker; poses by their numbers."""

    recipe: str
    poses: tuple[tuple[int, SE3, FloatArray], ...]
    clamp: bool
    options: SynthesisOptions | None
    parent: int


def _jobs(
    tasks: Sequence[GraspTask],
    poses: Sequence[Pose],
    clamp: bool,
    options: SynthesisOptions | None,
) -> list[_Job]:
    by_task: dict[GraspTask, list[int]] = {}
    for index, task in enumerate(tasks):
        by_task.setdefault(task, []).append(index)
    jobs = []
    for task, numbers in by_task.items():
        recipe = recipe_of(task)
        for begin in range(0, len(numbers), AT_ONCE):
            some = numbers[begin : begin + AT_ONCE]
            sent = tuple((i, SE3(poses[i][0]), poses[i][1]) for i in some)
            jobs.append(
                _Job(recipe=recipe, poses=sent, clamp=clamp, options=options, parent=os.getpid())
            )
    return jobs


def _by_workers(
    jobs: Sequence[_Job], tasks: Sequence[GraspTask], workers: int, backend: str
) -> Iterator[Result]:
    results = finished(
        _work, jobs, workers=workers, backend=backend, given_up=partial(_given_up, tasks)
    )
    for sent in results:
        for index, content in sent:
            yield index, _Reader(io.BytesIO(content), tasks[index]).load()


def _work(job: _Job) -> list[tuple[int, bytes]]:
    """Numbers and pickled results of a job, in a worker, which leaves Ctrl-C to its parent."""
    end_with(job.parent)
    with nullcontext() if os.getpid() == job.parent else on_interrupt(signal.SIG_IGN):
        task = task_of(job.recipe)
        return [
            (index, _packed(_refined(task, T_world_base, q, job.clamp, job.options)))
            for index, T_world_base, q in job.poses
        ]


def _given_up(tasks: Sequence[GraspTask], job: _Job, reason: str) -> list[tuple[int, bytes]]:
    """The results of a job that kills its worker."""
    failure = Failure(kind="worker_died", text=reason)
    return [
        (index, _packed(RefinedGrasp.untried(tasks[index], T_world_base, q, failure)))
        for index, T_world_base, q in job.poses
    ]


def _packed(result: RefinedGrasp) -> bytes:
    stream = io.BytesIO()
    _Writer(stream).dump(result)
    return stream.getvalue()


class _Writer(pickle.Pickler):
    """Writes the fingers of a task in its place."""

    def persistent_id(self, obj: Any) -> Any:
        return obj.finger_names if isinstance(obj, GraspTask) else None


class _Reader(pickle.Unpickler):
    """Puts the caller's task with these fingers there again."""

    def __init__(self, stream: io.BytesIO, task: GraspTask) -> None:
        super().__init__(stream)
        self._task = task

    def persistent_load(self, pid: Any) -> GraspTask:
        return with_fingers(self._task, pid)
