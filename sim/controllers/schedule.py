"""``ContactSchedule``: which fingers hold the object now, and how much of their force each has.

A finger holds if it is wanted and its pad has felt the object for some steps. What it may press is
its share, in [0, 1]: it falls along a ramp when a finger is to leave, at once when the contact is
lost, and rises along a ramp when a finger comes (back). A finger that is wanted but does not touch
is searching; one that is not wanted and has given its force away is free.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner.spatial import FloatArray

RAMP = 0.1
"""Time (s) in which a finger takes or gives away its whole force: slow beside the bandwidth."""

TOUCH_FORCE, LOST_FORCE = 0.1, 0.03
"""Normal forces (N) from which on a finger touches, and below which it has lost the object: a tenth
of what moves an object of 0.1 kg, and both far above rounding; apart, so that noise does not toggle
them."""

TOUCH_TIME, LOST_TIME = 0.006, 0.006
"""How long (s) that must last: three steps of 2 ms."""


class ContactSchedule:
    """States of n fingers.

    Attributes:
        share: (n,), share of its force that each finger has, in [0, 1].
        wanted: (n,), which fingers are to hold the object.
        touching: (n,), which pads feel it.
    """

    def __init__(self, touching: NDArray[np.bool_]) -> None:
        """All fingers are wanted; those that touch (n,) hold at once."""
        self.touching = np.array(touching, dtype=bool)
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
        due = self._lasting >= np.where(self.touching, LOST_TIME, TOUCH_TIME) - elapsed / 2
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
