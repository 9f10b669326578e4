"""``SlipDetector``: notices that the object slides over a pad.

A slip is a tangential speed above ``SLIP_SPEED`` for 10 ms at a loaded contact. The detector sees a
pad's sliding velocity with noise and averages it over some milliseconds; what it reports ends when
the average has fallen to half of the speed of the alarm. A pad that spins creeps, far inside its
cone (see ``sim.controllers.pads.CREEP``). That is a slip like any other if it is fast enough, but
no sign that friction is wanting, and told apart.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim.controllers.pads import PadReading

__all__ = ["LOADED", "SLIP_SPEED", "SlipDetector"]

SLIP_SPEED = 0.005
"""Tangential speed (m/s) of an object over a pad that counts as a slip."""

AVERAGE_TIME = 0.008
"""Time constant (s) of the average of the measured velocity: white noise of 2 mm/s at 500 Hz leaves
0.7 mm/s, and a slip at 6 mm/s is seen some 20 ms after it began."""

ALARM_SPEED, ALARM_TIME = 0.0045, 0.008
"""Averaged speed (m/s) that raises the alarm when it lasts this long (s). A little below what is
called a slip, so that short ones are found; slower creeping is then sometimes called one."""

LOADED = 0.05
"""Normal force (N) from which on a contact is loaded: below, sliding means that it opens."""


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

    @property
    def slipping(self) -> NDArray[np.bool_]:
        """Which fingers slip now, (n,)."""
        return np.asarray(self._slipping[0])

    def update(self, elapsed: float, pads: PadReading) -> NDArray[np.bool_]:
        """Which fingers have just begun to slip, (n,).

        Args:
            elapsed: Time since the last call, s.
            pads: What the pads say.
        """
        share = elapsed / (AVERAGE_TIME + elapsed)
        loaded = pads.normal_force > LOADED
        if loaded.all():
            self._average += share * (pads.sliding - self._average)
            self._creep += share * (pads.creep_speed - self._creep)
        else:
            seen = np.where(loaded[:, None], pads.sliding, 0.0)
            self._average = loaded[:, None] * (self._average + share * (seen - self._average))
            self._creep += share * (loaded * pads.creep_speed - self._creep)
        self.speed = np.sqrt((self._average * self._average).sum(axis=1))
        self._speeds[0], self._speeds[1] = self.speed, self.speed - self._creep
        self._above = (self._above + elapsed) * (self._speeds > ALARM_SPEED)
        begins = (self._above >= ALARM_TIME - elapsed / 2) & ~self._slipping
        self._slipping = (self._slipping | begins) & (self._speeds > ALARM_SPEED / 2)
        self.begun_beyond_spin = np.asarray(begins[1])
        return np.asarray(begins[0])
