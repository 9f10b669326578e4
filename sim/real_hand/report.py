"""``LoopReport``: how a run of a loop went, in counts and times."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from rich.console import Console, ConsoleOptions, RenderResult

from planner.arrays import finite, short_repr
from planner.spatial import FloatArray
from sim.tables import table_of

MICRO = 1e6

FORMAT = "opposable-loop-report"

VERSION = 1


@dataclass(frozen=True, kw_only=True)
class Times:
    """Times of the ticks of a loop, microseconds: median, 99 of 100, worst."""

    p50: float
    p99: float
    worst: float

    @classmethod
    def of(cls, seconds: FloatArray) -> Times:
        """Of times (m,) in s; NaN without any."""
        if not len(seconds):
            return cls(p50=np.nan, p99=np.nan, worst=np.nan)
        p50, p99 = np.percentile(seconds, (50, 99))
        return cls(p50=MICRO * p50, p99=MICRO * p99, worst=MICRO * float(seconds.max()))

    def __str__(self) -> str:
        """In words."""
        return f"{self.p50:.0f} / {self.p99:.0f} / {self.worst:.0f} us"


@dataclass(frozen=True, kw_only=True)
class LoopReport:
    """How a run went.

    Attributes:
        reason: "" where all phases are done; why it ended otherwise: a ``StopCause``, or "too few
            fingers touch", after which the hand holds its last command.
        detail: The same with numbers and names.
        on_stop: What was done at an emergency stop; "" where there was none.
        controller: Name of the controller.
        assumed: Senses for which planned values stood in.
        phases: Phases that were begun.
        rate_hz: Rate of the loop, Hz.
        duration_s: From the beginning of the first tick to the end of the last, s.
        ticks: How often the hand was read and a command found.
        written: How many commands were written.
        misses: Ticks that ended after their deadline.
        most_misses_in_a_row: Of these, the most one after the other.
        skipped: Slots in which no tick began.
        latency_us: From when a tick was due until its command was written, us.
        interface_cpu_us: CPU time per tick of reading and writing, us.
        controller_cpu_us: Of the controller.
        loop_cpu_us: Of the loop itself.
        oldest_reading_ms: Age of the oldest reading that was used, ms.
        repeated_readings: Ticks whose reading was that of the tick before.
        clamped: Actuator -> how often a wanted command lay outside its range; only those > 0.
        rate_limited: Actuator -> how often a wanted command was led to it more slowly.
        efforts_checked: Whether the hand reads efforts, so that their limit was checked.
    """

    reason: str
    detail: str
    on_stop: str
    controller: str
    assumed: tuple[str, ...]
    phases: tuple[str, ...]
    rate_hz: float
    duration_s: float
    ticks: int
    written: int
    misses: int
    most_misses_in_a_row: int
    skipped: int
    latency_us: Times
    interface_cpu_us: Times
    controller_cpu_us: Times
    loop_cpu_us: Times
    oldest_reading_ms: float
    repeated_readings: int
    clamped: Mapping[str, int]
    rate_limited: Mapping[str, int]
    efforts_checked: bool

    @property
    def done(self) -> bool:
        """Whether all phases were run to their end."""
        return not self.reason

    @property
    def stopped(self) -> bool:
        """Whether it ended by an emergency stop."""
        return bool(self.on_stop)

    def to_dict(self) -> dict[str, Any]:
        """Plain data for JSON; null for a number that is not there."""
        head = {"format": FORMAT, "version": VERSION, "done": self.done}
        data: dict[str, Any] = finite(head | asdict(self))
        return data

    def __repr__(self) -> str:
        """One line."""
        return short_repr(self)

    def __str__(self) -> str:
        """The outcome in a line."""
        if self.done:
            return (
                f"done: {self.ticks} ticks at {self.rate_hz:g} Hz, {self.misses} deadlines missed"
            )
        after = f"; then: {self.on_stop}" if self.on_stop else "; it holds the last command"
        return f"ended: {self.reason}: {self.detail}{after}"

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """A table of the counts, for a terminal."""
        table = table_of(str(self), ("of the loop",), ("value",))
        missed = f"{self.misses} of {self.ticks}, at most {self.most_misses_in_a_row} in a row"
        for name, value in {
            "controller": self.controller,
            "phases": ", ".join(self.phases),
            "assumed instead of read": ", ".join(self.assumed) or "nothing",
            "rate, duration": f"{self.rate_hz:g} Hz, {self.duration_s:.2f} s",
            "commands written": str(self.written),
            "deadlines missed": missed,
            "slots skipped": str(self.skipped),
            "latency p50 / p99 / worst": str(self.latency_us),
            "CPU of the interface": str(self.interface_cpu_us),
            "CPU of the controller": str(self.controller_cpu_us),
            "CPU of the loop": str(self.loop_cpu_us),
            "oldest reading": f"{self.oldest_reading_ms:.1f} ms",
            "readings used again": str(self.repeated_readings),
            "clamped to the range": _counts(self.clamped),
            "limited in rate": _counts(self.rate_limited),
            "efforts": "checked" if self.efforts_checked else "not read, not checked",
        }.items():
            table.add_row(name, value)
        yield table


def _counts(counts: Mapping[str, int]) -> str:
    """The largest counts by name."""
    if not counts:
        return "none"
    first = sorted(counts, key=counts.__getitem__, reverse=True)[:3]
    more = f", {len(counts) - len(first)} more" if len(counts) > len(first) else ""
    return ", ".join(f"{name} {counts[name]}" for name in first) + more
