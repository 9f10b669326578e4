"""Long pieces of work: how far they are, and ``Runner``, their jobs here or in processes.

``ProgressBar`` is a bar on a terminal, a line now and then elsewhere.

Ctrl-C keeps what is done. A worker that dies costs no more than time (``planner.batch.pool``).
"""

from __future__ import annotations

import math
import os
import platform
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any, Self, TypeAlias, TypeVar

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from planner.batch.pool import LOKY, end_with, finished
from planner.system.package import written_by

__all__ = ["Check", "ProgressBar", "Runner", "made_with"]


DRAW_S = 0.1
"""Shortest time (s) between two drawings of the bar."""

LINE_S, LINE_SHARE = 10.0, 0.1
"""Shortest time between two lines where there is no terminal: so long (s), and so large a share of
the time since the beginning. An hour has some 30 of them."""


class ProgressBar:
    """Counts, a note, and time taken and left; use it as a context.

    Attributes:
        done: What was shown last, 0 before.
    """

    def __init__(
        self,
        console: Console,
        *,
        ticks: bool = False,
        quiet: bool = False,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """A bar on a console.

        Args:
            console: Where: stderr, so that results can be piped.
            ticks: Whether the clock runs on while nothing comes. A thread draws it then, and beside
                a thread no worker may be forked.
            quiet: Show nothing at all.
            clock: Tells the time, s.
        """
        self.done = 0
        self._console, self._clock = console, clock
        self._on_terminal, self._quiet = console.is_terminal, quiet or console.quiet
        self._bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[note]}"),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(),
            console=console,
            disable=self._quiet or not self._on_terminal,
            transient=True,
            auto_refresh=ticks,
        )
        self._row: TaskID | None = None
        self._title = self._line = ""
        self._first = 0
        self._begin = self._titled = clock()
        self._told, self._drawn = self._begin, -math.inf
        self._tells = False

    def __enter__(self) -> Self:
        """Start."""
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Remove the bar; where lines were printed, the last state becomes one."""
        self._bar.stop()
        if self._tells and self._line:
            self._print(self._line)

    def show(self, title: str, done: int, total: int, note: str = "") -> None:
        """Show how far it is.

        Args:
            title: What is at work; another title begins another bar, with a clock of its own.
            done: How many are done, with those of earlier runs.
            total: How many there are.
            note: What else there is to say, such as a rate.
        """
        self.done = done
        now = self._clock()
        if title != self._title or self._row is None:
            if self._row is not None:
                self._bar.remove_task(self._row)
            self._row = self._bar.add_task(title, total=total, completed=done, note=note)
            self._title, self._first, self._titled = title, done, now
        draws = now - self._drawn >= DRAW_S or done == total
        self._drawn = now if draws else self._drawn
        self._bar.update(self._row, completed=done, total=total, note=note, refresh=draws)
        if not (self._on_terminal or self._quiet):
            self._tell(title, done, total, note, now)

    def _tell(self, title: str, done: int, total: int, note: str, now: float) -> None:
        fresh, taken = done - self._first, now - self._titled
        left = f", {_duration(taken / fresh * (total - done))} left" if fresh > 0 else ""
        note = f", {note}" if note else ""
        self._line = f"{title}: {done} of {total}{note}, {_duration(taken)}{left}"
        if now - self._told >= max(LINE_S, LINE_SHARE * (now - self._begin)):
            self._print(self._line)
            self._told, self._tells, self._line = now, True, ""

    def _print(self, line: str) -> None:
        self._console.print(line, highlight=False, markup=False, soft_wrap=True)


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}"


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
