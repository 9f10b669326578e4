"""Parallel jobs that outlive dying workers; the requests of a batch, and what plans one.

Jobs in parallel: results as they are finished, even if workers die.

Workers are copies of this process ("fork") where that is safe: a copy has libraries, hand, tasks
and machine code already, so that a worker costs milliseconds instead of the seconds of a new
process. Jobs are sent to them in portions that take some tenths of a second, so that messages cost
little and workers end together. joblib's backends carry the same jobs to processes ("loky"),
threads ("threading") and, where they are installed, to a cluster ("dask", "ray").

A worker that dies takes no result of others with it: the pool is started again, and what was in
flight is done once more, alone, so that a job that kills its worker is found out.

The requests of a batch, each with its own seed, and the function that plans one.

A request's seed follows from the batch's seed, the object's shape and the grasp's number alone.
It does not depend on the worker, the order, or the rest of the batch.
"""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import pickle
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice
from typing import Any, TypeVar

import joblib
import numpy as np
from joblib import wrap_non_picklable_objects

from planner.arrays import checked_count
from planner.batch.recipe import recipe_of, task_of
from planner.batch.rows import failed_row, found_row
from planner.errors import NoGraspFoundError, PlannerError, TaskError, shown
from planner.numerics.kernels import compiled_searches
from planner.plan import GraspPlan
from planner.search.grasp import Attempt, plan_grasp
from planner.shapes import Mesh, shape_key
from planner.synthesis.options import SynthesisOptions
from planner.system.threads import on_interrupt, safe_path, unheard_by_children
from planner.task import GraspTask


@dataclass(frozen=True, kw_only=True)
class BatchObject:
    """One object of a batch.

    Attributes:
        label: Its name, unique in the batch.
        recipe: Its task as text (``planner.batch.recipe``).
        key: Identity of its shape, hexadecimal (``planner.shapes.shape_key``).
    """

    label: str
    recipe: str
    key: str

    @classmethod
    def of(cls, label: str, task: GraspTask) -> BatchObject:
        """The object of a task."""
        return cls(label=label, recipe=recipe_of(task), key=shape_key(task.object.shape))


@dataclass(frozen=True, kw_only=True)
class Job:
    """One requested grasp, as it is sent to a worker.

    Attributes:
        index: Its number in the batch; rows are sorted by it.
        object: Which object.
        k: Number of the grasp among those of its object.
        seed: Seed of its search.
        max_attempts: Attempts before giving up.
        options: Margins, weights and objectives of the search.
        parent: Process that started the batch.
        max_cpu_s: CPU seconds before giving up; None for no limit.
    """

    index: int
    object: BatchObject
    k: int
    seed: int
    max_attempts: int
    options: SynthesisOptions | None
    parent: int
    max_cpu_s: float | None = None


def grasp_seed(seed: int, key: str, k: int) -> int:
    """Seed of grasp k of the shape with a key: 63 bits from ``numpy.random.SeedSequence``.

    Of a million grasps two share a seed with a chance of 5e-8.
    """
    words = [int(key[i : i + 8], 16) for i in range(0, len(key), 8)]
    state = np.random.SeedSequence(seed, spawn_key=(*words, k)).generate_state(1, np.uint64)
    return int(state[0] >> np.uint64(1))


def batch_jobs(
    objects: Sequence[BatchObject],
    n: int,
    seed: int,
    wanted: Callable[[int], bool],
    max_attempts: int,
    options: SynthesisOptions | None,
    max_cpu_s: float | None = None,
) -> Iterator[Job]:
    """The requests of a batch that are still wanted, object by object, one at a time.

    Args:
        objects: The objects.
        n: Grasps per object.
        seed: Seed of the batch.
        wanted: Whether a request's number is still to be planned.
        max_attempts: Attempts before giving up.
        options: Margins, weights and objectives of the search.
        max_cpu_s: CPU seconds before giving up; None for no limit.
    """
    for number, item in enumerate(objects):
        for k in range(n):
            index = number * n + k
            if wanted(index):
                yield Job(
                    index=index,
                    object=item,
                    k=k,
                    seed=grasp_seed(seed, item.key, k),
                    max_attempts=max_attempts,
                    max_cpu_s=max_cpu_s,
                    options=options,
                    parent=os.getpid(),
                )


def warm_up(job: Job) -> None:
    """Load and compile what planning a job takes, by one attempt at a convex object.

    That is the job's own object or, if that is a mesh, a ball: whatever a job may do to its
    process, it is not done here.
    """
    try:
        task = task_of(job.object.recipe)
        if isinstance(task.object.shape, Mesh):
            task = GraspTask.create(task.hand, "sphere")
        with compiled_searches():
            plan_grasp(task, seed=0, max_attempts=1, options=job.options)
    except PlannerError:
        return  # what was loaded is loaded; the jobs' rows have their own reasons


def plan_row(job: Job) -> dict[str, Any]:
    """Plan one request; a row of ``planner.batch.rows`` whether or not a grasp was found.

    A refusal by the planner (an object too large for the hand) is a row with that reason; only
    faults of the program are raised.
    """
    made: list[Attempt[GraspPlan]] = []
    end_with(job.parent)
    with _undisturbed(job.parent) as check:

        def note(attempt: Attempt[GraspPlan]) -> None:
            made.append(attempt)
            check()

        try:
            task = task_of(job.object.recipe)
            with compiled_searches():
                plan = plan_grasp(
                    task,
                    seed=job.seed,
                    max_attempts=job.max_attempts,
                    max_cpu_s=job.max_cpu_s,
                    options=job.options,
                    progress=note,
                )
        except NoGraspFoundError:
            return failed_row(
                job.index, job.object.label, job.k, job.seed, str(made[-1].failure), made
            )
        except PlannerError as error:
            return failed_row(job.index, job.object.label, job.k, job.seed, str(error), made)
        return found_row(job.index, job.object.label, job.k, plan, made)


@lru_cache(maxsize=1)
def end_with(parent: int) -> None:
    """End this worker when the process that started it is killed.

    By hand: joblib's workers wait for their next job until they time out, minutes later.
    """

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(WATCH_S)
        os._exit(1)

    if os.getppid() == parent:
        threading.Thread(target=watch, daemon=True).start()


WATCH_S = 0.2
"""Period (s) of the check whether that process is alive."""


@contextmanager
def _undisturbed(parent: int) -> Iterator[Callable[[], None]]:
    """Keep Ctrl-C out of a solver, which would call it a failed attempt and go on with the next.

    A worker ignores Ctrl-C: the process that started the batch ends it. That process itself
    notes it and is interrupted between attempts, by the function given here.
    """
    pressed: list[bool] = []

    def check() -> None:
        if pressed:
            raise KeyboardInterrupt

    ours = os.getpid() == parent
    with on_interrupt((lambda *_: pressed.append(True)) if ours else signal.SIG_IGN):
        yield check
    check()


Item = TypeVar("Item")
Result = TypeVar("Result")

FORK = "fork"
"""Name of this backend beside those of joblib."""

PORTION_S = 0.2
"""Time (s) that a portion of jobs should take: what a worker may be idle for at the end."""

MOST_JOBS = 32
"""Most jobs of a portion (-). The jobs of a worker that dies are done again, one by one."""

AHEAD = 2
"""Portions per worker that are sent before the first is finished, so that none waits."""


def can_fork() -> bool:
    """Whether a copy of this process is sound: on Linux, and while no other thread runs Python.

    A thread that held a lock would not be there in the copy to let it go.
    """
    return sys.platform == "linux" and threading.active_count() == 1


def forked_results(
    work: Callable[[Item], Result], jobs: Iterator[tuple[int, Item]], workers: int
) -> Iterator[tuple[int, Result]]:
    """Numbers and results of jobs as they are finished, in any order.

    Workers begin when the first jobs are known, and inherit everything that is loaded by then.

    Args:
        work: Called with each job.
        jobs: Their numbers and jobs, asked for the next as workers become free.
        workers: Their number.

    Raises:
        BrokenProcessPool: A worker has died.
    """
    before = set(multiprocessing.active_children())
    context = multiprocessing.get_context("fork")
    pool = ProcessPoolExecutor(
        workers, mp_context=context, initializer=_begin, initargs=(os.getpid(), work)
    )
    finished = False
    try:
        yield from _in_portions(pool, jobs, workers)
        finished = True
    finally:
        if not finished:
            for worker in set(multiprocessing.active_children()) - before:
                worker.terminate()
        pool.shutdown(wait=True, cancel_futures=True)


def _in_portions(
    pool: ProcessPoolExecutor, jobs: Iterator[tuple[int, Any]], workers: int
) -> Iterator[tuple[int, Any]]:
    """Send portions and give back what they bring."""
    size, sent = 1, set[Future[bytes]]()
    while True:
        while len(sent) < AHEAD * workers and (portion := list(islice(jobs, size))):
            with unheard_by_children():
                sent.add(pool.submit(_done, _packed(portion)))
        if not sent:
            return
        ready, sent = wait(sent, return_when=FIRST_COMPLETED)
        for future in ready:
            taken, results = pickle.loads(future.result())
            size = max(1, min(MOST_JOBS, 2 * size, int(PORTION_S * len(results) / taken)))
            yield from results


PR_SET_PDEATHSIG = 1
"""``prctl``: the kernel sends this signal when the parent dies, even where a library holds Python's
lock, under which no thread that watches the parent runs."""

_inherited: dict[str, Callable[[Any], Any]] = {}
"""In a worker: what it does with a job, which need not be sent."""


def _done(portion: bytes) -> bytes:
    """Time (s) and results of a portion, in a worker; packed, as the portion is."""
    work, begin = _inherited["work"], time.perf_counter()
    results = [(number, work(job)) for number, job in pickle.loads(portion)]
    return _packed((max(time.perf_counter() - begin, 1e-6), results))


def _packed(thing: Any) -> bytes:
    """As it is sent; functions without a name too, as joblib sends them."""
    try:
        return pickle.dumps(thing)
    except (pickle.PicklingError, AttributeError, TypeError):
        return pickle.dumps(wrap_non_picklable_objects(thing, keep_wrapper=False))


def _begin(parent: int, work: Callable[[Any], Any]) -> None:
    """A worker leaves Ctrl-C to the process that started it, and ends with that process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:  # it was killed before the kernel was told
        os._exit(1)
    end_with.cache_clear()  # of that process
    end_with(parent)
    _inherited["work"] = work


DEATHS_ALONE = 2
"""Deaths of a worker with this job alone before the job is given up: the system may have caused
one, since it ends processes when memory is short."""

DEATHS = (
    ("distributed.scheduler", "KilledWorker"),
    ("ray.exceptions", "RayActorError"),
    ("ray.exceptions", "WorkerCrashedError"),
)
"""Modules and exceptions of clusters for a worker that has died; Dask tries a job four times
before."""

MOST_WORKERS = 1024
"""Most processes of a pool: each loads all libraries and models."""

LOKY = "loky"
"""joblib's backend of processes that are started anew."""

AT_ONCE = 4
"""Jobs per worker and wave for a backend without a stream of results."""


def default_backend(workers: int) -> str:
    """The backend where none is named: copies of this process where that is safe."""
    return FORK if workers != 1 and can_fork() else LOKY


def check_backend(backend: str, workers: int) -> None:
    """Refuse a backend that joblib does not have, or that is not ready, or a number of workers.

    Raises:
        TaskError: So; or ``workers`` is neither -1 nor a number of processes.
    """
    _check_workers(workers)
    if backend == FORK:
        if not can_fork():
            raise TaskError(
                "workers cannot be forked here: that takes Linux, and no other thread; use the "
                "backend 'loky'"
            )
        return
    try:
        with joblib.parallel_config(backend=backend, n_jobs=workers):
            pass
    except (ImportError, TypeError, ValueError) as error:
        raise TaskError(
            f"joblib cannot use the backend {shown(backend)}: {error}. Use fork, loky, threading "
            "or multiprocessing; dask after making a dask.distributed.Client; ray after "
            "ray.util.joblib.register_ray()"
        ) from error


def _check_workers(workers: int) -> None:
    if workers != -1:
        what = "workers (-1: one per core)"
        checked_count(what, workers, least=1, most=MOST_WORKERS, error=TaskError)


def planned_rows(jobs: Iterable[Job], workers: int, backend: str) -> Iterator[dict[str, Any]]:
    """Rows of requests as they are finished, in any order."""

    def given_up(job: Job, reason: str) -> dict[str, Any]:
        return failed_row(job.index, job.object.label, job.k, job.seed, reason, ())

    jobs = _loaded_for(jobs) if backend == FORK else jobs
    return finished(plan_row, jobs, workers=workers, backend=backend, given_up=given_up)


def _loaded_for(jobs: Iterable[Job]) -> Iterator[Job]:
    """The jobs, once this process has loaded what workers that are copies of it will need."""
    for number, job in enumerate(jobs):
        if number == 0:
            warm_up(job)
        yield job


def finished(
    work: Callable[[Item], Result],
    jobs: Iterable[Item],
    *,
    workers: int,
    backend: str,
    given_up: Callable[[Item, str], Result],
) -> Iterator[Result]:
    """Results of jobs as they are finished, in any order.

    Args:
        work: Called with each job by a worker.
        jobs: Asked for the next one as workers become free.
        workers: Their number; -1 for one per core.
        backend: joblib's name of a backend.
        given_up: The result of a job that kills its worker again and again, called here with the
            job and the reason in words.

    Raises:
        TaskError: ``workers`` is neither -1 nor a number of processes.
    """
    _check_workers(workers)
    in_flight: dict[int, Item] = {}

    def sent() -> Iterator[tuple[int, Item]]:
        for number, job in enumerate(jobs):
            in_flight[number] = job
            yield number, job

    source = sent()
    while True:
        try:
            for number, result in _stream(work, source, workers, backend):
                del in_flight[number]
                yield result
            return
        except _deaths():
            for job in list(in_flight.values()):
                yield _alone(work, job, backend, given_up)
            in_flight.clear()


def _deaths() -> tuple[type[BaseException], ...]:
    """Exceptions with which backends say that a worker has died, of those that are loaded."""
    modules = ((sys.modules.get(module), name) for module, name in DEATHS)
    return BrokenProcessPool, *(getattr(module, name) for module, name in modules if module)


def _numbered(work: Callable[[Item], Result], number: int, job: Item) -> tuple[int, Result]:
    """A job's number and result, in a worker."""
    return number, work(job)


def _stream(
    work: Callable[[Item], Result],
    jobs: Iterator[tuple[int, Item]],
    workers: int,
    backend: str,
) -> Iterator[tuple[int, Result]]:
    """Numbers and results of jobs, one job per message, so that little is in flight.

    The iterator is asked for more as workers become free. Workers import nothing from the current
    folder, also those that are started again later.
    """
    if backend == FORK:
        yield from forked_results(work, jobs, joblib.cpu_count() if workers == -1 else workers)
        return
    call = joblib.delayed(_numbered)
    with safe_path(), joblib.parallel_config(backend=backend, n_jobs=workers):
        active, n_workers = joblib.parallel.get_active_backend()
        if active.supports_return_generator:
            parallel = joblib.Parallel(return_as="generator_unordered", batch_size=1)
            with unheard_by_children():  # one that is still loading libraries prints a traceback
                results = parallel(call(work, *job) for job in jobs)
            yield from results
            return
        at_once = AT_ONCE * active.effective_n_jobs(n_workers)
        with joblib.Parallel(batch_size=1) as parallel:  # the same workers for all waves
            while wave := [job for _, job in zip(range(at_once), jobs, strict=False)]:
                yield from parallel(call(work, *job) for job in wave)


def _alone(
    work: Callable[[Item], Result],
    job: Item,
    backend: str,
    given_up: Callable[[Item, str], Result],
) -> Result:
    """The result of a job that was in flight when a worker died, with no other beside it."""
    for _ in range(DEATHS_ALONE):
        try:
            ((_, result),) = _stream(work, iter([(0, job)]), 2, backend)
            return result
        except _deaths():
            continue
    return given_up(
        job, f"its process died {1 + DEATHS_ALONE} times, killed or by a fault in a library"
    )
