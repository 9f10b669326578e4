"""Many grasps at a time: planned into a folder, a few as plans, or given ones refined.

``plan_grasps``: many grasps of many objects, on all cores, into a folder.

``plan_several``: a few grasps of one task as plans, the first found or as different as can be.

Diverse ones are chosen among more that were found, by farthest-point selection: the best comes
first, then again and again the grasp that is farthest from all chosen ones. The distance is that of
``planner.batch.diversity``: the largest difference of base position, base rotation, contacts and
joints, each divided by the tolerance within which grasps are near-duplicates (10 mm, 10 degrees,
5 mm, 10 degrees). Base and contacts are compared in the object's frame, and near-duplicates of a
chosen grasp are never chosen.

``refine_grasps``: many given hand poses brought to grasps, here or in processes, as they come.
Workers make the task from its text (``planner.batch.recipe``). A result comes back pickled with the
fingers in place of its task, since hands cannot be sent; here it gets the caller's own task again.
"""

from __future__ import annotations

import io
import os
import pickle
import signal
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from shutil import rmtree
from tempfile import mkdtemp
from typing import Any
from weakref import finalize

import numpy as np

from planner.batch.dataset import GraspSet
from planner.batch.diversity import GraspFeatures, distances
from planner.batch.pool import (
    BatchObject,
    batch_jobs,
    check_backend,
    default_backend,
    end_with,
    finished,
    planned_rows,
)
from planner.batch.recipe import Manifest, ManifestObject, Recipe, label_of, recipe_of, task_of
from planner.batch.rows import grasp_schema
from planner.batch.store import Store
from planner.errors import PlannerError, TaskError, shown
from planner.failure import Failure
from planner.hand_loading import load_hand
from planner.hands.hand import Hand
from planner.objects import GraspObject
from planner.plan import GraspPlan
from planner.search.attempt import Attempt, nothing_found, search
from planner.search.grasp import DEFAULT_MAX_ATTEMPTS, Wanted, attempts
from planner.search.refine import RefinedGrasp, refine_grasp, with_fingers
from planner.spatial import SE3, FloatArray, IntArray
from planner.synthesis.options import SynthesisOptions
from planner.system.package import written_by
from planner.system.threads import on_interrupt
from planner.task import GraspTask


@dataclass(frozen=True, kw_only=True)
class BatchProgress:
    """How far a batch is.

    Attributes:
        total: Requested grasps.
        done: Planned grasps, found or not.
        kept: Grasps planned by earlier runs.
        found: Grasps that this run found.
        elapsed_s: Time since this run began, s.
    """

    total: int
    done: int
    kept: int
    found: int
    elapsed_s: float

    @property
    def rate(self) -> float:
        """Requests of this run per second of time, 1/s."""
        return (self.done - self.kept) / self.elapsed_s if self.elapsed_s > 0 else 0.0


def plan_grasps(
    hand: Hand | str | Path,
    objects: Sequence[str | GraspObject | GraspTask],
    n: int,
    *,
    seed: int = 0,
    workers: int = -1,
    backend: str | None = None,
    out: Path | str | None = None,
    options: SynthesisOptions | None = None,
    max_attempts: int = DEFAULT_MAX_ATTEMPTS,
    max_cpu_s: float | None = None,
    progress: Callable[[BatchProgress], None] | None = None,
) -> GraspSet:
    """Plan n grasps of each object; grasp k of an object depends on seed, its shape and k alone.

    Args:
        hand: The hand, its name, or the path of its description.
        objects: Objects, specifications such as "box:0.05x0.05x0.08", or whole tasks with this
            hand, for other friction, fingers or surroundings. A request is searched for as
            ``plan_grasp`` does, compiled from the first attempt: its row's seed gives the same plan
            there, to the bit within ``planner.compiled_searches``.
        n: Grasps per object.
        seed: Same seed, same grasps, for any number of workers.
        workers: Processes (or what the backend has); -1 for one per core, 1 for this process.
        backend: joblib's name of a backend, or "fork": workers begin as copies of this process, in
            milliseconds. None for "fork" on Linux while no other thread runs Python, else "loky".
            Threads take turns, so they are no faster than one.
        out: Folder of the dataset; a batch that is there goes on. A temporary one if None, which
            lives as long as the result.
        options: Margins, weights and objectives of the search.
        max_attempts: Attempts per grasp before it counts as not found.
        max_cpu_s: CPU seconds per grasp before it counts as not found, looked at between attempts;
            which grasps are found then depends on the machine. None for no limit.
        progress: Called at the beginning and after every grasp.

    Returns:
        The grasps, read from disk as they are asked for.

    Raises:
        PlannerError: Bad input; no Parquet library; a folder with another batch.
        KeyboardInterrupt: Ctrl-C; what was planned is kept, and the same call goes on.
    """
    tasks = _tasks(hand, objects)
    for name, value, least in (("n", n, 1), ("seed", seed, 0), ("max_attempts", max_attempts, 1)):
        if isinstance(value, bool) or not isinstance(value, int) or value < least:
            raise TaskError(f"{name} is {shown(value)}; give an integer >= {least}")
    if max_cpu_s is not None and not max_cpu_s > 0:
        raise TaskError(f"max_cpu_s is {max_cpu_s}; give seconds > 0, or None for no limit")
    if isinstance(workers, bool) or not isinstance(workers, int) or workers == 0:
        raise TaskError(f"workers is {shown(workers)}; give their number, or -1 for one per core")
    items = [BatchObject.of(label, task) for label, task in tasks.items()]
    loaded = next(iter(tasks.values())).hand
    schema = grasp_schema(loaded)
    manifest = Manifest(
        written_by=written_by(),
        hand=loaded.name,
        joint_names=list(loaded.joint_names),
        n=n,
        seed=seed,
        max_attempts=max_attempts,
        max_cpu_s=max_cpu_s,
        options=(options or SynthesisOptions()).to_dict(),
        objects=[
            ManifestObject(label=label, **dict(Recipe.of(task))) for label, task in tasks.items()
        ],
    )
    backend = default_backend(workers) if backend is None else backend
    check_backend(backend, workers)
    folder = Path(mkdtemp(prefix="opposable-")) if out is None else Path(out)
    try:
        with Store(folder, manifest, schema) as store:
            jobs = batch_jobs(
                items, n, seed, lambda i: not store.has(i), max_attempts, options, max_cpu_s
            )
            _fill(store, planned_rows(jobs, workers, backend), progress)
        grasps = GraspSet(folder)
    except BaseException:
        if out is None:
            rmtree(folder)
        raise
    if out is None:
        finalize(grasps, _remove, folder, os.getpid())
    return grasps


def _remove(folder: Path, owner: int) -> None:
    """Remove the folder of grasps that nobody wanted kept; a fork of its owner leaves it there."""
    if os.getpid() == owner:
        rmtree(folder, ignore_errors=True)


def _fill(
    store: Store,
    rows: Iterable[dict[str, Any]],
    progress: Callable[[BatchProgress], None] | None,
) -> None:
    """Store rows as they come, and report progress."""
    kept, found, begin = len(store), 0, time.monotonic()

    def report() -> None:
        if progress is not None:
            progress(
                BatchProgress(
                    total=store.manifest.total,
                    done=len(store),
                    kept=kept,
                    found=found,
                    elapsed_s=time.monotonic() - begin,
                )
            )

    report()
    for row in rows:
        store.add(row)
        found += row["found"]
        report()


def _tasks(
    hand: Hand | str | Path, objects: Sequence[str | GraspObject | GraspTask]
) -> dict[str, GraspTask]:
    """The tasks by the labels of their objects.

    They are made from their own text, as workers make them, so that a task without a text is
    refused here.
    """
    if isinstance(objects, str | GraspObject | GraspTask):
        raise TaskError(f"objects is {shown(objects)}; give a list, even of one")
    hand = hand if isinstance(hand, Hand) else load_hand(hand)
    tasks: dict[str, GraspTask] = {}
    for item in objects:
        task = item if isinstance(item, GraspTask) else GraspTask.create(hand, item)
        if task.hand.digest != hand.digest:
            raise TaskError(
                f"the task {task!r} is for another hand than {hand.name}; a batch has one hand"
            )
        label = label_of(task)
        if label in tasks:
            raise TaskError(
                f"two objects are called {label!r}; give a GraspObject another name, or ask for "
                "more grasps of one"
            )
        tasks[label] = task_of(recipe_of(task))
    if not tasks:
        raise TaskError("there are no objects; name at least one")
    return tasks


FOUND_PER_CHOSEN = 4
"""Grasps that are found for each diverse one that is chosen."""


def plan_several(
    task: GraspTask,
    n: int,
    *,
    diverse: bool = False,
    seed: int = 0,
    max_attempts: int | None = None,
    max_cpu_s: float | None = None,
    metric: str | Mapping[str, float] | None = None,
    options: SynthesisOptions | None = None,
    progress: Callable[[Attempt[GraspPlan]], object] | None = None,
) -> list[GraspPlan]:
    """Up to n grasps of a task, fewer where the budget gives no more; many are ``plan_grasps``'.

    The attempts are those of ``plan_grasp`` with the same seed, one after the other.

    Args:
        task: What to grasp, with what, where.
        n: How many.
        diverse: Whether they are chosen to differ, among four times as many that are found; the
            best by the metric is the first. Otherwise they are the first n found.
        seed: Same seed, same grasps, unless ``max_cpu_s`` ends the search.
        max_attempts: Budget in attempts; None for 100 for each grasp to be found.
        max_cpu_s: Budget in CPU seconds, looked at between attempts; None for no limit.
        metric: By what the first of diverse grasps is chosen, as in ``plan_grasp``.
        options: Margins, weights and objectives of the problem.
        progress: Called after every attempt; where it returns True the search ends with what it
            has.

    Returns:
        At least one plan, in the order in which they were chosen or found.

    Raises:
        NoGraspFoundError: Not one was found.
        NotFoundError: A metric that does not exist.
        TaskError: n is below 1, or below 2 for diverse ones; the task cannot work; a budget is not
            positive; a metric where the first are taken.
    """
    if isinstance(n, bool) or not isinstance(n, int | np.integer) or n < 1:
        raise TaskError(f"n is {shown(n)}; give an integer, at least 1")
    if diverse and n == 1:
        raise TaskError("one grasp cannot be diverse; give n of at least 2, or leave diverse out")
    if metric is not None and not diverse:
        raise TaskError(
            f"metric is {shown(metric)}, but the first {n} grasps are taken, whatever they are "
            "worth; give diverse=True too, or leave it out"
        )
    found_at_most = n * FOUND_PER_CHOSEN if diverse else n
    wanted = Wanted.of(
        max_attempts=max_attempts or DEFAULT_MAX_ATTEMPTS * found_at_most,
        max_cpu_s=max_cpu_s,
        best_of=found_at_most,
        metric=metric,
        options=options,
    )
    best, made = search(
        attempts(task, seed=seed, options=wanted.options),
        max_attempts=wanted.max_attempts,
        max_cpu_s=max_cpu_s,
        best_of=found_at_most,
        progress=progress,
    )
    if best is None:
        raise nothing_found(
            f"grasp of {task.object.name} with {task.hand.name}", made, "Try more attempts"
        )
    found = [attempt.plan for attempt in made if attempt.plan is not None]
    if not diverse:
        return found
    first = int(np.argmax([wanted.value(plan) for plan in found]))
    return [found[i] for i in farthest_points(GraspFeatures.of_plans(found), n, first)]


def farthest_points(grasps: GraspFeatures, n: int, first: int) -> IntArray:
    """Numbers of up to n grasps (m,), each the farthest from those before it; no near-duplicates.

    Args:
        grasps: What is chosen from.
        n: How many.
        first: Number of the first one.
    """
    chosen = [first]
    everything = np.arange(len(grasps))
    nearest = distances(grasps, first, everything)
    while len(chosen) < n:
        farthest = int(nearest.argmax())  # of equal ones the first
        if nearest[farthest] <= 1.0:
            break
        chosen.append(farthest)
        nearest = np.minimum(nearest, distances(grasps, farthest, everything))
    return np.array(chosen, dtype=np.int64)


def separations(plans: Sequence[GraspPlan]) -> FloatArray:
    """Distance of every plan (n,) from the nearest other one, in tolerances; inf for a single one.

    Raises:
        TaskError: There is none, or they are of different tasks.
    """
    grasps, everything = GraspFeatures.of_plans(plans), np.arange(len(plans))
    apart = np.array([distances(grasps, i, everything) for i in range(len(plans))])
    np.fill_diagonal(apart, np.inf)
    nearest: FloatArray = apart.min(axis=1)
    return nearest


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
