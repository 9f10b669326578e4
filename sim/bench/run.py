"""Jobs of a measurement, here or in processes, with a progress bar; Ctrl-C keeps what is done."""

from __future__ import annotations

import os
import platform
import signal
from collections.abc import Callable, Iterator, Sequence
from importlib.metadata import version
from typing import Any, TypeVar

import joblib
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

__all__ = ["made_with", "run_all"]

Job = TypeVar("Job")
Result = TypeVar("Result")


def made_with() -> dict[str, Any]:
    """What a measurement was made with and on, for its file.

    The load average (processes that want the processor, over the last minute) tells whether the
    machine was quiet.
    """
    return {
        "written_by": f"opposable {version('opposable')}",
        "machine": f"{platform.machine()}, Python {platform.python_version()}",
        "cores": os.cpu_count(),
        "load_average": round(os.getloadavg()[0], 2),
    }


def run_all(
    work: Callable[[Job, Callable[[], None]], Result],
    jobs: Sequence[Job],
    *,
    workers: int,
    title: str,
    console: Console,
    keep: Callable[[Result], None],
    check: Callable[[], None],
) -> bool:
    """Work on jobs and hand over each result as it comes.

    Args:
        work: Called with a job and a function that raises a lost Ctrl-C.
        jobs: The jobs.
        workers: Processes; 1 for this one.
        title: What the bar says.
        console: Where the bar goes.
        keep: Called here with every result, in the order in which they are finished.
        check: Raises the KeyboardInterrupt that a solver swallowed, if there was one.

    Returns:
        Whether all were done; False after Ctrl-C.
    """
    bar = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        console=console,
    )
    with bar as progress:
        row = progress.add_task(title, total=len(jobs))
        try:
            for result in _results(work, jobs, workers, check):
                keep(result)
                progress.advance(row)
        except KeyboardInterrupt:
            return False
    return True


def _results(
    work: Callable[[Job, Callable[[], None]], Result],
    jobs: Sequence[Job],
    workers: int,
    check: Callable[[], None],
) -> Iterator[Result]:
    if workers == 1:
        for job in jobs:
            yield work(job, check)
        return
    parallel = joblib.Parallel(n_jobs=workers, batch_size=1, return_as="generator_unordered")
    yield from parallel(joblib.delayed(_in_worker)(work, job) for job in jobs)


def _in_worker(work: Callable[[Job, Callable[[], None]], Result], job: Job) -> Result:
    """Work in another process, which leaves Ctrl-C to the one that started it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    return work(job, _nothing)


def _nothing() -> None:
    """The check of a worker."""
