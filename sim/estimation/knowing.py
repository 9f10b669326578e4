"""``Knowing``: the moment at which an estimator no longer knows where the object is.

A pose counts as known while the believed errors stay below limits; with hysteresis, so that it
does not change to and fro.
"""

from __future__ import annotations

import math

import numpy as np

from planner.spatial import FloatArray
from sim.controllers import Event

LOST = (0.01, math.radians(15.0))
"""Believed errors, m and rad (root mean squares), beyond which a pose is not known."""

FOUND = 0.7
"""Share of these below which it is known again."""


class Knowing:
    """Whether the pose is known.

    Attributes:
        known: Whether it is.
    """

    def __init__(self) -> None:
        """It is known, until it is not."""
        self.known = True
        self._events: list[Event] = []

    @property
    def events(self) -> tuple[Event, ...]:
        """What changed, in order."""
        return tuple(self._events)

    def update(self, time: float, covariance: FloatArray) -> bool:
        """Take over the covariance (6, 6) of a pose at a time (s); whether it is known."""
        diagonal = np.maximum(np.diagonal(covariance), 0.0)
        off, turned = math.sqrt(diagonal[:3].sum()), math.sqrt(diagonal[3:].sum())
        share = max(off / LOST[0], turned / LOST[1])
        if self.known != (share < (1.0 if self.known else FOUND)):
            self.known = not self.known
            detail = f"{1e3 * off:.1f} mm and {math.degrees(turned):.1f} degrees"
            self._events.append(
                Event(
                    time=time,
                    kind="pose known again" if self.known else "pose lost",
                    detail=f"believed to be off by {detail}",
                )
            )
        return self.known
