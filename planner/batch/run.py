"""``plan_grasps``: many grasps of many objects on all cores, through joblib.

joblib's backends carry the same jobs to processes ("loky"), threads ("threading") and, where they
are installed, to a cluster ("dask", "ray"). Results come back in any order and are stored at once.
A worker that dies takes no result of others with it: the pool is started again, and what was in
flight is planned once more, alone, so that a request that kills its worker is found out.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import joblib

from planner.batch.dataset import GraspSet
from planner.batch.jobs import BatchObject, Job, batch_jobs, grasp_seed, plan_row
from planner.batch.manifest import Manifest, ManifestObject, written_by
from planner.batch.recipe import label_of, recipe_of, task_of
from planner.batch.rows import failed_row, grasp_schema
from planner.batch.store import Store
from planner.errors import TaskError
from planner.files import TaskData
from planner.hand import Hand
from planner.objects import GraspObject
from planner.search import DEFAULT_MAX_ATTEMPTS
from planner.synthesis.options import SynthesisOptions
from planner.task import GraspTask

__all__ = ["BatchProgress", "plan_grasps"]

DEATHS_ALONE = 2
"""How often a request may kill a worker that has nothing else to do before it is given up: one
death may be the work of the system, which ends a process when memory is short."""

FEWEST_AT_ONCE = 4
"""Jobs per worker that a backend without a stream of results gets at a time."""


@dataclass(frozen=True, kw_only=True)
class BatchProgress:
    """How far a batch is.

    Attributes:
        total: Requested grasps.
        done: Those that are planned, found or not.
        kept: Those that were there when this run began.
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
    backend: str = "loky",
    out: Path | str | None = None,
    options: SynthesisOptions | None = None,
    max_attempts: int = DEFAULT_MAX_ATTEMPTS,
    progress: Callable[[BatchProgress], None] | None = None,
) -> GraspSet:
    """Plan n grasps of each object; grasp k of an object depends on seed, its shape and k alone.

    Args:
        hand: The hand, its name, or the path of its description.
        objects: Objects, specifications such as "box:0.05x0.05x0.08", or whole tasks with this
            hand, for other friction, fingers or surroundings.
        n: Grasps per object.
        seed: Same seed, same grasps, whatever the workers.
        workers: Processes (or what the backend has); -1 for one per core, 1 for this process.
        backend: joblib's name of a backend. Threads take turns, so they are no faster than one.
        out: Folder of the dataset; a batch that is there goes on. A temporary one if None, which
            lives as long as the result.
        options: Margins and weights of the NLP.
        max_attempts: Attempts per grasp before it counts as not found.
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
            raise TaskError(f"{name} is {value!r}; give an integer >= {least}")
    if isinstance(workers, bool) or not isinstance(workers, int) or workers == 0:
        raise TaskError(f"workers is {workers!r}; give their number, or -1 for one per core")
    items = [BatchObject(label=label, recipe=recipe_of(task)) for label, task in tasks.items()]
    shapes = {label: task.object.shape for label, task in tasks.items()}
    loaded = next(iter(tasks.values())).hand
    manifest = Manifest(
        written_by=written_by(),
        hand=loaded.name,
        joint_names=list(loaded.joint_names),
        n=n,
        seed=seed,
        max_attempts=max_attempts,
        options=asdict(options or SynthesisOptions()),
        objects=[
            ManifestObject(label=i.label, task=TaskData.model_validate_json(i.recipe))
            for i in items
        ],
    )
    schema = grasp_schema(loaded)
    _check_backend(backend, workers)
    temporary = None
    if out is None:
        temporary = TemporaryDirectory(prefix="opposable-")
        out = temporary.name
    folder = Path(out)
    with Store(folder, manifest, schema) as store:
        kept, found, begin = len(store), 0, time.monotonic()

        def tell() -> None:
            if progress is not None:
                progress(
                    BatchProgress(
                        total=manifest.total,
                        done=len(store),
                        kept=kept,
                        found=found,
                        elapsed_s=time.monotonic() - begin,
                    )
                )

        tell()
        jobs = batch_jobs(
            items,
            lambda item, k: grasp_seed(seed, shapes[item.label], k),
            n,
            lambda index: not store.has(index),
            max_attempts,
            options,
        )
        for row in _rows(jobs, workers, backend):
            store.add(row)
            found += row["found"]
            tell()
    return GraspSet(folder, temporary=temporary)


def _tasks(
    hand: Hand | str | Path, objects: Sequence[str | GraspObject | GraspTask]
) -> dict[str, GraspTask]:
    """The tasks by what their objects are called.

    They are made from their own text, as workers make them: what cannot be made ends here.
    """
    if isinstance(objects, str | GraspObject | GraspTask):
        raise TaskError(f"objects is {objects!r}; give a list, even of one")
    hand = hand if isinstance(hand, Hand) else Hand.load(hand)
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


def _check_backend(backend: str, workers: int) -> None:
    """Refuse a backend that joblib does not have, or that is not ready.

    Raises:
        TaskError: So.
    """
    try:
        with joblib.parallel_config(backend=backend, n_jobs=workers):
            pass
    except (ImportError, TypeError, ValueError) as error:
        raise TaskError(
            f"joblib cannot use the backend {backend!r}: {error}. Use loky, threading or "
            "multiprocessing; dask after making a dask.distributed.Client; ray after "
            "ray.util.joblib.register_ray()"
        ) from error


def _rows(jobs: Iterable[Job], workers: int, backend: str) -> Iterator[dict[str, Any]]:
    """Rows as they are finished, in any order."""
    in_flight: dict[int, Job] = {}

    def sent() -> Iterator[Job]:
        for job in jobs:
            in_flight[job.index] = job
            yield job

    source = sent()
    while True:
        try:
            for row in _stream(source, workers, backend):
                del in_flight[row["index"]]
                yield row
            return
        except BrokenProcessPool:
            for job in list(in_flight.values()):
                yield _alone(job, backend)
            in_flight.clear()


def _stream(jobs: Iterator[Job], workers: int, backend: str) -> Iterator[dict[str, Any]]:
    """Rows of jobs, one job per message, so that little is in flight.

    The iterator is asked for more as workers become free.
    """
    with joblib.parallel_config(backend=backend, n_jobs=workers):
        active, n_workers = joblib.parallel.get_active_backend()
        if active.supports_return_generator:
            parallel = joblib.Parallel(return_as="generator_unordered", batch_size=1)
            yield from parallel(joblib.delayed(plan_row)(job) for job in jobs)
            return
        at_once = FEWEST_AT_ONCE * active.effective_n_jobs(n_workers)
        while wave := [job for _, job in zip(range(at_once), jobs, strict=False)]:
            yield from joblib.Parallel(batch_size=1)(joblib.delayed(plan_row)(job) for job in wave)


def _alone(job: Job, backend: str) -> dict[str, Any]:
    """The row of a job that was in flight when a worker died, planned with no other beside it."""
    for _ in range(DEATHS_ALONE):
        try:
            return next(_stream(iter([job]), 2, backend))
        except BrokenProcessPool:
            continue
    reason = f"its process died {1 + DEATHS_ALONE} times, killed or by a fault in a library"
    return failed_row(job.index, job.object.label, job.k, job.seed, reason, ())
