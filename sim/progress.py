"""How far a long piece of work is: a bar on a terminal, a line now and then elsewhere.

Called by ``sim.runner`` for measurements and by the commands that plan, learn or export much.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Self

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

__all__ = ["ProgressBar"]

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
