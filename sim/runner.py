"""``Runner``: the jobs of a measurement, here or in processes, with a progress bar.

Ctrl-C keeps what is done. A worker that dies costs no more than time (``planner.batch.pool``).
"""

from __future__ import annotations

import os
import platform
import shlex
import signal
import subprocess
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

from rich.console import Console

from planner.batch.pool import LOKY, end_with, finished
from planner.system.package import written_by
from sim.progress import ProgressBar

__all__ = ["Check", "Runner", "made_with"]

Job = TypeVar("Job")
Result = TypeVar("Result")

Check: TypeAlias = Callable[[], None]
"""Raises the KeyboardInterrupt that a solver swallowed, if there was one."""


def made_with() -> dict[str, Any]:
    """What a measurement was made with and on, and when, for its file.

    The load average (processes that want the processor, over the last minute) tells whether the
    machine was quiet. Without a checkout there is no commit, and outside of the command line no
    command: both are "" then.
    """
    return {
        "written_by": written_by(),
        "command": _command(),
        "date": datetime.now(UTC).date().isoformat(),
        "commit": _commit(),
        "machine": f"{platform.machine()}, Python {platform.python_version()}",
        "cores": os.cpu_count(),
        "load_average": round(os.getloadavg()[0], 2),
    }


def _command() -> str:
    """The command line, where it is one of ours."""
    program, words = Path(sys.argv[0]), sys.argv[1:]
    if program.name == "__main__.py" and program.parent.name == "benchmarks":
        return shlex.join(["python", "-m", "benchmarks", *words])
    if program.name == "opposable":
        measured = words[:1] == ["bench"]
        return shlex.join(
            ["python", "-m", "benchmarks", *words[1:]] if measured else ["opposable", *words]
        )
    return ""


def _commit() -> str:
    """The commit of the checkout, "-dirty" at its end where files differ from it."""
    root = Path(__file__).resolve().parent.parent
    if not (root / ".git").exists():
        return ""
    asked = ["git", "-C", str(root), "describe", "--always", "--dirty", "--exclude=*"]
    try:
        done = subprocess.run(asked, capture_output=True, text=True, check=False)
    except OSError:  # there is no git
        return ""
    return done.stdout.strip()


@dataclass(frozen=True, kw_only=True)
class Runner:
    """How the jobs of a measurement are worked on.

    Attributes:
        console: Where the progress bar goes.
        check: For work in this process.
        workers: Processes; 1 for this one.
    """

    console: Console
    check: Check
    workers: int = 1

    def run(
        self,
        work: Callable[[Job, Check], Result],
        jobs: Sequence[Job],
        *,
        title: str,
        keep: Callable[[Result], object],
        given_up: Callable[[Job, str], Result],
    ) -> bool:
        """Work on jobs and hand over each result as it comes.

        Args:
            work: Called with a job and a function that raises a lost Ctrl-C.
            jobs: The jobs.
            title: What the bar says.
            keep: Called here with every result, in the order in which they are finished.
            given_up: The result of a job that killed every process that tried it; called with the
                job and the reason in words.

        Returns:
            Whether all were done; False after Ctrl-C.
        """
        if self.workers == 1:
            return self.run_here(work, jobs, title=title, keep=keep)
        results = finished(
            partial(_in_worker, work, os.getpid()),
            jobs,
            workers=self.workers,
            backend=LOKY,  # a copy of a process that has drawn something hangs when it draws
            given_up=given_up,
        )
        return self._keep_all(results, len(jobs), title, keep)

    def run_here(
        self,
        work: Callable[[Job, Check], Result],
        jobs: Sequence[Job],
        *,
        title: str,
        keep: Callable[[Result], object],
    ) -> bool:
        """Work on jobs in this process, however many workers there are; see ``run``."""
        results = (work(job, self.check) for job in jobs)
        return self._keep_all(results, len(jobs), title, keep)

    def _keep_all(
        self,
        results: Iterable[Result],
        total: int,
        title: str,
        keep: Callable[[Result], object],
    ) -> bool:
        with ProgressBar(self.console, ticks=self.workers == 1) as bar:
            bar.show(title, 0, total)
            try:
                for done, result in enumerate(results, start=1):
                    keep(result)
                    bar.show(title, done, total)
            except KeyboardInterrupt:
                return False
        return True


def _in_worker(work: Callable[[Job, Check], Result], parent: int, job: Job) -> Result:
    """Work in another process, which leaves Ctrl-C to the one that started it and ends with it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with(parent)
    return work(job, _nothing)


def _nothing() -> None:
    """The check of a worker."""
