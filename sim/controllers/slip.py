"""``SlipDetector``: notices that the object slides over a pad, and ``score_slips``: how well.

A slip is a tangential speed above ``SLIP_SPEED`` for ``SLIP_TIME`` at a loaded contact; that is
also how ground truth is told, from exact velocities. The detector sees a pad's sliding velocity
with noise and averages it over some milliseconds; what it reports ends when the average has fallen
to half of that speed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner.spatial import FloatArray
from sim.controllers.pads import PadReading

__all__ = [
    "SLIP_SPEED",
    "SLIP_TIME",
    "Slip",
    "SlipDetector",
    "SlipScore",
    "score_slips",
    "true_slips",
]

SLIP_SPEED, SLIP_TIME = 0.005, 0.01
"""What counts as a slip: this tangential speed (m/s), for this long (s)."""

AVERAGE_TIME = 0.008
"""Time constant (s) of the average of the measured velocity: white noise of 2 mm/s at 500 Hz leaves
0.7 mm/s, and a slip at 6 mm/s is seen some 20 ms after it began."""

ALARM_SPEED, ALARM_TIME = 0.0045, 0.008
"""Averaged speed (m/s) that raises the alarm when it lasts this long (s). A little below what is
called a slip, so that short ones are found; slower creeping is then sometimes called one."""

LOADED = 0.05
"""Normal force (N) from which on a contact is loaded: below, sliding means that it opens."""

LATENCY = 0.05
"""A slip counts as found when the alarm comes within this time (s) of its beginning."""


class SlipDetector:
    """Watches the pads of n fingers.

    Attributes:
        slipping: (n,), which fingers slip now.
        speed: (n,), averaged sliding speed, m/s.
    """

    def __init__(self, n: int) -> None:
        """Nothing slips yet."""
        self.slipping: NDArray[np.bool_] = np.zeros(n, dtype=bool)
        self._average = np.zeros((n, 3))
        self._above = np.zeros(n)
        self.speed = np.zeros(n)

    def update(self, elapsed: float, pads: PadReading) -> NDArray[np.bool_]:
        """Which fingers have just begun to slip, (n,).

        Args:
            elapsed: Time since the last call, s.
            pads: What the pads say.
        """
        share = elapsed / (AVERAGE_TIME + elapsed)
        loaded = pads.normal_force > LOADED
        self._average += share * (np.nan_to_num(pads.sliding) - self._average)
        self._average[~loaded] = 0.0
        self.speed = np.sqrt((self._average**2).sum(axis=1))
        fast = self.speed > ALARM_SPEED
        self._above = np.where(fast, self._above + elapsed, 0.0)
        begins = (self._above >= ALARM_TIME) & ~self.slipping
        self.slipping = (self.slipping | begins) & (self.speed > ALARM_SPEED / 2)
        return np.asarray(begins)


@dataclass(frozen=True, kw_only=True)
class Slip:
    """One finger's slip, or an alarm.

    Attributes:
        finger: Number of the finger.
        begin: When the speed first was too high, s (for an alarm: when it was raised).
        end: When it last was, s.
    """

    finger: int
    begin: float
    end: float


@dataclass(frozen=True, kw_only=True)
class SlipScore:
    """How well a detector did.

    Attributes:
        slips: How many true slips there were.
        found: How many of them were found within ``LATENCY``.
        alarms: How many alarms were raised.
        right: How many of them fell into a true slip, or at most ``LATENCY`` after it.
        delay: Median time from the beginning of a found slip to its alarm, s; NaN if none.
    """

    slips: int
    found: int
    alarms: int
    right: int
    delay: float

    @property
    def recall(self) -> float:
        """Share of the true slips that were found; NaN if there were none."""
        return self.found / self.slips if self.slips else float("nan")

    @property
    def precision(self) -> float:
        """Share of the alarms that were right; NaN if there were none."""
        return self.right / self.alarms if self.alarms else float("nan")


def true_slips(times: FloatArray, speed: FloatArray, normal_force: FloatArray) -> list[Slip]:
    """Slips by definition, from exact speeds.

    Args:
        times: (m,), s.
        speed: (m, n), tangential speed per finger, m/s.
        normal_force: (m, n), N.
    """
    sliding = (speed > SLIP_SPEED) & (normal_force > LOADED)
    found = []
    for finger in range(speed.shape[1]):
        edges = np.flatnonzero(np.diff(np.r_[False, sliding[:, finger], False].astype(int)))
        for first, after in edges.reshape(-1, 2):
            begin, end = float(times[first]), float(times[after - 1])
            if end - begin >= SLIP_TIME:
                found.append(Slip(finger=finger, begin=begin, end=end))
    return found


def score_slips(slips: Sequence[Slip], alarms: Sequence[Slip]) -> SlipScore:
    """Compare alarms with true slips of the same fingers."""
    delays = []
    for slip in slips:
        late = [
            alarm.begin - slip.begin
            for alarm in alarms
            if alarm.finger == slip.finger
            and alarm.begin <= slip.begin + LATENCY
            and alarm.end >= slip.begin
        ]
        if late:
            delays.append(max(0.0, min(late)))
    right = sum(
        any(s.finger == a.finger and s.begin <= a.begin <= s.end + LATENCY for s in slips)
        for a in alarms
    )
    return SlipScore(
        slips=len(slips),
        found=len(delays),
        alarms=len(alarms),
        right=right,
        delay=float(np.median(delays)) if delays else float("nan"),
    )
