"""``SlipDetector`` and ``InfeasibilityMonitor``: failures of a grasp, noticed as they happen.

A slip is a tangential speed above ``SLIP_SPEED`` for 10 ms at a loaded contact. The detector sees a
pad's sliding velocity with noise and averages it over some readings; a slip that it reports
ends when the average has fallen to half of the speed of the alarm. A pad that spins creeps far
inside its friction cone (``sim.controllers.base.CREEP``): such sliding is a slip if it is fast
enough, but no sign of too little friction, and is reported separately.

A wrench is infeasible while no contact forces within friction, normal forces and actuators give it.

``ContactSchedule``: which fingers hold the object now, and how much of their force each has.

A finger holds if it is wanted and its pad has felt the object for some steps. What it may press is
its share, in [0, 1]: it falls along a ramp when a finger is to leave, at once when the contact is
lost, and rises along a ramp when a finger comes (back). A finger that is wanted but does not touch
is searching; one that is not wanted and has given its force away is free.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planner.spatial import FloatArray
from sim.controllers.base import LOST_FORCE, TOUCH_FORCE, EventKind, PadReading

RAMP = 0.1
"""Time (s) in which a finger takes or gives away its whole force: slow beside the bandwidth."""

TOUCH_TIME, LOST_TIME = 0.006, 0.006
"""How long (s) that must last: three steps of 2 ms."""


class ContactSchedule:
    """States of n fingers.

    Attributes:
        share: (n,), share of its force that each finger has, in [0, 1].
        wanted: (n,), which fingers are to hold the object.
        touching: (n,), which pads feel it.
        lost_time: How long (s) a pad must feel nothing for its contact to be lost; may be set.
    """

    def __init__(self, touching: NDArray[np.bool_]) -> None:
        """All fingers are wanted; those that touch (n,) hold at once."""
        self.touching = np.array(touching, dtype=bool)
        self.lost_time = LOST_TIME
        self.wanted = np.ones(len(touching), dtype=bool)
        self.share = self.touching.astype(np.float64)
        self._lasting = np.zeros(len(touching))
        self._none: NDArray[np.bool_] = np.zeros(len(touching), dtype=bool)
        self._none.flags.writeable = False
        self._settled = False  # all touch, with their whole share, and none is about to be lost

    @property
    def holding(self) -> NDArray[np.bool_]:
        """Which fingers may press, (n,)."""
        return np.asarray(self.touching & (self.share > 0))

    @property
    def searching(self) -> NDArray[np.bool_]:
        """Which fingers are wanted but do not touch, (n,)."""
        return np.asarray(self.wanted & ~self.touching)

    def step(
        self, elapsed: float, normal_force: FloatArray
    ) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Go on by one step.

        Args:
            elapsed: Time since the last call, s.
            normal_force: What the pads feel (n,), N.

        Returns:
            Which wanted fingers have just lost the object, and which have just found it, (n,) each.
        """
        if self._settled and normal_force.min() >= LOST_FORCE and self.wanted.all():
            return self._none, self._none
        changes = np.where(self.touching, normal_force < LOST_FORCE, normal_force > TOUCH_FORCE)
        self._lasting = np.where(changes, self._lasting + elapsed, 0.0)
        due = self._lasting >= np.where(self.touching, self.lost_time, TOUCH_TIME) - elapsed / 2
        lost, found = due & self.touching, due & ~self.touching
        self.touching = self.touching ^ due
        self._lasting[due] = 0.0
        rate = elapsed / RAMP
        toward = self.wanted & self.touching
        self.share = np.clip(self.share + np.where(toward, rate, -rate), 0.0, 1.0)
        self.share[~self.touching] = 0.0
        self._settled = bool(
            self.touching.all() and (self.share == 1.0).all() and not self._lasting.any()
        )
        return lost & self.wanted, found & self.wanted


SLIP_SPEED = 0.005
"""Tangential speed (m/s) of an object over a pad that counts as a slip."""

AVERAGE_TIME = 0.008
"""Time constant (s) of the average of the measured velocity: white noise of 2 mm/s at 500 Hz leaves
0.7 mm/s, and a slip at 6 mm/s is seen some 20 ms after it began."""

READING_TIME = 0.002
"""Longest time (s) for which one reading counts. Pads slower than the control loop repeat the same
noise at several steps: 2 mm/s, held for 10 ms, was called a slip 6 times in 80 s of a finger, and
more often where pads creep. So averages and alarms take as many readings as at 500 Hz: at 100 Hz a
slip at 8 mm/s is seen 50 to 70 ms after it began."""

ALARM_SPEED, ALARM_TIME = 0.0045, 0.008
"""Averaged speed (m/s) that raises the alarm when it lasts this long (s). A little below what is
called a slip, so that short ones are found; slower creeping is then sometimes called one."""

LOADED = 0.05
"""Normal force (N) from which on a contact is loaded: below, sliding means that it opens."""

MISSED_TOL = 0.05
"""A wrench counts as missed when more than this share of it, or this many N, is left over."""

GIVING_TOL = 0.002
"""The least normal forces give way when more than this share of a wrench, or this many N, is left
over: the wrench comes before the grip."""

LEAST_GIVEN, GIVING_TIME, TAKING_TIME = 0.1, 0.05, 0.5
"""While a wrench is missed the least normal forces fall to this share (-): all of them in the first
time (s), and back in the second. A finger that must press where its force cannot be balanced blocks
the wrench itself. The larger grip after a slip gives way too: it needs actuators with a margin."""

INFEASIBLE_TIME, PATIENCE = 0.006, 0.5
"""How long (s) a wrench must be missed to be called infeasible, and to give up."""


class SlipDetector:
    """Watches the pads of n fingers.

    Attributes:
        begun_beyond_spin: (n,), which have just begun to slip faster than spinning explains.
        speed: (n,), averaged sliding speed, m/s.
    """

    def __init__(self, n: int) -> None:
        """Nothing slips yet."""
        self.begun_beyond_spin: NDArray[np.bool_] = np.zeros(n, dtype=bool)
        self.speed = np.zeros(n)
        self._average = np.zeros((n, 3))
        self._creep = np.zeros(n)
        # of the speed, and of what spinning leaves of it
        self._speeds, self._above = np.zeros((2, 2, n))
        self._slipping: NDArray[np.bool_] = np.zeros((2, n), dtype=bool)
        self._felt: float | None = None  # when the last reading was

    @property
    def slipping(self) -> NDArray[np.bool_]:
        """Which fingers slip now, (n,)."""
        return np.asarray(self._slipping[0])

    def update(self, elapsed: float, pads: PadReading) -> NDArray[np.bool_]:
        """Which fingers have just begun to slip, (n,); a repeated reading tells nothing.

        Args:
            elapsed: Time since the last call, s.
            pads: What the pads say.
        """
        if pads.time is not None:
            if pads.time == self._felt:
                self.begun_beyond_spin = np.zeros(len(self.speed), dtype=bool)
                return self.begun_beyond_spin.copy()
            since = elapsed if self._felt is None else pads.time - self._felt
            self._felt, elapsed = pads.time, min(READING_TIME, since)
        share = elapsed / (AVERAGE_TIME + elapsed)
        loaded = pads.normal_force > LOADED
        sliding = np.where(loaded[:, None], pads.sliding, 0.0)
        self._average = loaded[:, None] * (self._average + share * (sliding - self._average))
        self._creep += share * (loaded * pads.creep_speed - self._creep)
        self._speeds[0] = np.sqrt((self._average * self._average).sum(axis=1))
        self._speeds[1] = self._speeds[0] - self._creep
        self._above = (self._above + elapsed) * (self._speeds > ALARM_SPEED)
        begins = (self._above >= ALARM_TIME - elapsed / 2) & ~self._slipping
        self.speed = self._speeds[0]
        if pads.slipping is None:
            self._slipping = (self._slipping | begins) & (self._speeds > ALARM_SPEED / 2)
        else:  # pads that notice slips by themselves
            begins = pads.slipping & ~self._slipping
            self._slipping[:] = pads.slipping
        self.begun_beyond_spin = np.asarray(begins[1])
        return np.asarray(begins[0])


class InfeasibilityMonitor:
    """Times for which a wrench has been missed, and the reactions to it.

    Attributes:
        missed: Missed share of the last wrench (-).
        grip_share: Share of the least normal forces that is asked for (-).
        gave_up: Why it gave up, "" while it has not; "" again when it is over.
    """

    def __init__(self, needed: int, fingers: Sequence[str], what: str) -> None:
        """Watch a grasp.

        Args:
            needed: Fingers that can hold it.
            fingers: Names of those that take part, n.
            what: Name of the object.
        """
        self.missed, self.grip_share, self.gave_up = 0.0, 1.0, ""
        self._needed, self._fingers, self._what = needed, tuple(fingers), what
        self._missed_for = self._few_for = 0.0

    def update(
        self, elapsed: float, *, residual: float, wanted: float, holding: NDArray[np.bool_]
    ) -> list[tuple[EventKind, str]]:
        """Take over a step; returns the events to note.

        Args:
            elapsed: Since the last step, s.
            residual: Size of the unbalanced wrench, N.
            wanted: Size of the wanted wrench, N.
            holding: Which fingers (n,) hold.
        """
        self.missed = residual / max(1.0, wanted)
        missing = self.missed > MISSED_TOL
        rate = -1.0 / GIVING_TIME if self.missed > GIVING_TOL else 1.0 / TAKING_TIME
        self.grip_share = min(1.0, max(LEAST_GIVEN, self.grip_share + elapsed * rate))
        before = self._missed_for
        self._missed_for = before + elapsed if missing else 0.0
        count = int(holding.sum())
        few = count < self._needed
        self._few_for = self._few_for + elapsed if few else 0.0
        notes: list[tuple[EventKind, str]] = []

        def detail() -> str:
            names = [name for name, holds in zip(self._fingers, holding, strict=True) if holds]
            who = ", ".join(names) or "no finger"
            return f"{who} on {self._what}: {residual:.2f} N of {wanted:.2f} N cannot be exerted"

        if before < INFEASIBLE_TIME <= self._missed_for:
            notes.append(("infeasible", f"{detail()}; the nearest forces are given"))
        if before >= INFEASIBLE_TIME and self._missed_for == 0.0:
            notes.append(("feasible again", f"after {before:.3f} s"))
        if self.gave_up and (missing or few):
            return notes
        self.gave_up = ""
        if self._few_for > PATIENCE:
            self.gave_up = f"only {count} fingers hold, for {PATIENCE} s"
        elif self._missed_for > PATIENCE:
            self.gave_up = f"{detail()}, for {PATIENCE} s"
        if self.gave_up:
            notes.append(("gave up", self.gave_up))
        return notes
