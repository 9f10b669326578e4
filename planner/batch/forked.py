"""Workers that begin as copies of this process: ``forked_results``, and whether that is safe.

``planner.batch.pool`` asks, for the backend "fork". A copy has libraries, hand, tasks and machine
code already, so that a worker costs milliseconds instead of the seconds of a new process. Jobs are
sent in portions that take some tenths of a second, so that messages cost little and workers end
together.
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
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from itertools import islice
from typing import Any, TypeVar

from joblib import wrap_non_picklable_objects

from planner.batch.jobs import end_with
from planner.system.process import on_interrupt

FORK = "fork"
"""Name of this backend beside those of joblib."""

PORTION_S = 0.2
"""Time (s) that a portion of jobs should take: what a worker may be idle for at the end."""

MOST_JOBS = 32
"""Most jobs of a portion (-). The jobs of a worker that dies are done again, one by one."""

AHEAD = 2
"""Portions per worker that are sent before the first is finished, so that none waits."""

Item = TypeVar("Item")
Result = TypeVar("Result")


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
            with on_interrupt(signal.SIG_IGN):  # workers that are begun now inherit it
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
