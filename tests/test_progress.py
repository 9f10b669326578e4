"""``ProgressBar``: a bar on a terminal, a line now and then elsewhere, nothing if quiet."""

from __future__ import annotations

import io
from itertools import pairwise

from rich.console import Console

from sim.runner import LINE_S, LINE_SHARE, ProgressBar, Runner


class Clock:
    """Time that only the test lets pass, s."""

    now = 100.0

    def __call__(self) -> float:
        return self.now


def shown(seconds: float, each: float, *, terminal: bool = False, quiet: bool = False) -> str:
    """What is printed of a work of so many seconds that gives a result after each so many."""
    text, clock = io.StringIO(), Clock()
    console = Console(file=text, force_terminal=terminal, width=120)
    total = round(seconds / each)
    with ProgressBar(console, quiet=quiet, clock=clock) as bar:
        for done in range(total + 1):
            bar.show("planning", done, total, f"found {done}")
            clock.now += each
        assert bar.done == total
    return text.getvalue()


def test_without_a_terminal_there_is_a_line_now_and_then() -> None:
    lines = shown(600.0, 4.0).splitlines()
    assert lines[0] == "planning: 3 of 150, found 3, 0:00:12, 0:09:48 left"
    assert lines[-1] == "planning: 150 of 150, found 150, 0:10:00, 0:00:00 left"
    assert 10 < len(lines) < 40


def test_lines_become_rarer() -> None:
    """Of three hours, every second line at least waits for a share of the time that has passed."""
    text = shown(3 * 3600.0, 1.0)
    taken = [line.split(", ")[-2] for line in text.splitlines()]
    seconds = [sum(60**k * int(n) for k, n in enumerate(reversed(t.split(":")))) for t in taken]
    for a, b in pairwise(seconds[:-1]):
        assert max(LINE_S, LINE_SHARE * b) <= b - a <= max(LINE_S, LINE_SHARE * b) + 1.0


def test_a_short_work_and_a_quiet_one_print_nothing() -> None:
    assert shown(8.0, 1.0) == ""
    assert shown(600.0, 4.0, quiet=True) == ""
    assert shown(600.0, 4.0, terminal=True, quiet=True) == ""


def test_a_terminal_has_a_bar_that_goes_away() -> None:
    text = shown(600.0, 4.0, terminal=True)
    assert "150/150" in text
    assert "planning: " not in text
    assert text.endswith("\x1b[2K")  # the line is erased


def test_another_title_has_its_own_clock() -> None:
    text, clock = io.StringIO(), Clock()
    with ProgressBar(Console(file=text, width=120), clock=clock) as bar:
        bar.show("planning", 0, 10)
        clock.now += 100.0
        bar.show("holding", 20, 100)  # 20 of an earlier run
        clock.now += 20.0
        bar.show("holding", 30, 100)
    assert text.getvalue().splitlines() == [
        "holding: 20 of 100, 0:00:00",
        "holding: 30 of 100, 0:00:20, 0:02:20 left",
    ]


def test_a_measurement_counts_its_jobs() -> None:
    text = io.StringIO()
    runner = Runner(console=Console(file=text, force_terminal=True, width=90), check=lambda: None)
    kept: list[int] = []
    assert runner.run(
        lambda job, check: job + 1, [1, 2], title="add", keep=kept.append, given_up=lambda *_: 0
    )
    assert kept == [2, 3]
    assert "add" in text.getvalue() and "2/2" in text.getvalue()
