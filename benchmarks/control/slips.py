"""Slips as exact velocities tell them, and how well a detector found them.

A slip is a tangential speed above ``SLIP_SPEED`` for ``SLIP_TIME`` at a loaded contact.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planner.spatial import FloatArray
from sim.controllers.monitors import LOADED, SLIP_SPEED

SLIP_TIME = 0.01
"""How long (s) the speed must be too high."""

LATENCY = 0.05
"""A slip counts as found when the alarm comes within this time (s) of its beginning."""


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
        right: How many of them lasted while there was a true slip, or began at most ``LATENCY``
            after it.
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
        any(s.finger == a.finger and s.begin <= a.end and a.begin <= s.end + LATENCY for s in slips)
        for a in alarms
    )
    return SlipScore(
        slips=len(slips),
        found=len(delays),
        alarms=len(alarms),
        right=right,
        delay=float(np.median(delays)) if delays else float("nan"),
    )
