"""``Clock`` and ``Pace``: when a loop runs, which deadlines it missed, how late it was.

Time is cut into slots of one period. A tick begins with its slot and has met its deadline if it
ends before the next slot begins. After a miss the loop goes on at once, in the slot that it is
then: slots that have passed altogether are skipped, so that a late loop does not run faster later.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np

from planner.spatial import FloatArray

if TYPE_CHECKING:
    from sim.real_hand.plan_mark import PlanMark

LATE_TOL = 1e-9
"""Lateness (s) that is rounding."""


class Clock(Protocol):
    """Tells the time and waits; a test has its own."""

    def now(self) -> float:
        """Time, s; never goes back."""
        ...

    def sleep_until(self, moment: float) -> None:
        """Return at a time (s), or at once where it has passed."""
        ...


@runtime_checkable
class RecordedClock(Clock, Protocol):
    """A clock whose time is that of a recorded run: it serves the same run alone."""

    def need_same(self, rate_hz: float, plan: PlanMark | None) -> None:
        """Refuse a loop that is not the one that was recorded.

        Args:
            rate_hz: Its rate, Hz.
            plan: What it executes; None where it executes none.

        Raises:
            TaskError: Another rate, or another plan.
        """
        ...


class RealClock:
    """The system's monotonic clock, which nobody sets."""

    def now(self) -> float:
        """``time.monotonic()``, s."""
        return time.monotonic()

    def sleep_until(self, moment: float) -> None:
        """Sleep until a time (s)."""
        left = moment - time.monotonic()
        if left > 0.0:
            time.sleep(left)


class Pace:
    """Slots of one period.

    Attributes:
        period: Length of a slot, s.
        slot: Number of the slot of the present tick.
        begun: When the present tick began, s.
        misses: Ticks that ended after their slot.
        skipped: Slots in which no tick began.
        in_a_row: Misses since the last tick that ended in time.
        most_in_a_row: The most of these.
        duration: From the first tick's beginning to the last one's end, s.
    """

    def __init__(self, clock: Clock, period: float) -> None:
        """The first slot begins with the first tick."""
        self._clock = clock
        self.period = period
        self.slot = 0
        self.begun = 0.0
        self.misses = 0
        self.skipped = 0
        self.in_a_row = 0
        self.most_in_a_row = 0
        self.duration = 0.0
        self._first: float | None = None
        self._latencies: list[float] = []

    def begin(self) -> float:
        """Wait for the slot; returns the time at which the tick begins, s."""
        if self._first is None:
            self._first = self._clock.now()
        else:
            self._clock.sleep_until(self._first + self.slot * self.period)
        self.begun = self._clock.now()
        return self.begun

    def end(self) -> bool:
        """End the tick and choose the next slot; returns whether the deadline was missed."""
        first = 0.0 if self._first is None else self._first
        since = self._clock.now() - first
        self.duration = since
        latency = since - self.slot * self.period
        self._latencies.append(latency)
        missed = latency > self.period + LATE_TOL
        next_slot = self.slot + 1
        if missed:
            next_slot = max(next_slot, int((since + LATE_TOL) / self.period))
            self.misses += 1
            self.skipped += next_slot - self.slot - 1
        self.in_a_row = self.in_a_row + 1 if missed else 0
        self.most_in_a_row = max(self.most_in_a_row, self.in_a_row)
        self.slot = next_slot
        return missed

    def rest(self) -> None:
        """Wait for the next slot without beginning a tick: the last command acts that long."""
        if self._first is not None:
            self._clock.sleep_until(self._first + self.slot * self.period)

    @property
    def latencies(self) -> FloatArray:
        """(m,), time from the beginning of each tick's slot to the tick's end, s."""
        return np.array(self._latencies)
