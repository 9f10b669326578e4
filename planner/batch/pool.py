"""Jobs through joblib: rows as they are finished, whatever becomes of the workers.

joblib's backends carry the same jobs to processes ("loky"), threads ("threading") and, where they
are installed, to a cluster ("dask", "ray"). A worker that dies takes no result of others with it:
the pool is started again, and what was in flight is planned once more, alone, so that a request
that kills its worker is found out.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from concurrent.futures.process import BrokenProcessPool
from typing import Any

import joblib

from planner.batch.jobs import Job, plan_row
from planner.batch.rows import failed_row
from planner.errors import TaskError

__all__ = ["check_backend", "planned_rows"]

DEATHS_ALONE = 2
"""How often a request may kill a worker that has nothing else to do before it is given up: one
death may be the work of the system, which ends a process when memory is short."""

AT_ONCE = 4
"""Jobs per worker that a backend without a stream of results gets at a time."""


def check_backend(backend: str, workers: int) -> None:
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


def planned_rows(jobs: Iterable[Job], workers: int, backend: str) -> Iterator[dict[str, Any]]:
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
        at_once = AT_ONCE * active.effective_n_jobs(n_workers)
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
