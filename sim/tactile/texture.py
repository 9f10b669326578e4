"""``Texture``: how a rough surface that slides over a pad makes its taxels shiver.

Sliding is felt through the unevenness of what slides: asperities load now this spot of the skin and
now that one (R. D. Howe and M. R. Cutkosky, Sensing skin acceleration for slip and texture
perception, ICRA 1989; M. R. Tremblay and M. R. Cutkosky, Estimating friction using incipient slip
sensing during a manipulation task, ICRA 1993). MuJoCo's contacts are smooth, so this is a model of
its own: the force on each taxel is larger or smaller by a share with standard deviation ``SHARE``,
which forgets its value over a slid distance ``LENGTH`` and stays as it is while the pad sticks or
rolls. The force of the whole contact stays what it is. A polished object has none of it
(``share`` 0): then only joints tell that a pad slips.
"""

from __future__ import annotations

import math

import numpy as np

from planner.spatial import FloatArray

SHARE = 0.1
"""Standard deviation (-) of the force on a taxel over the texture: twice the noise of a taxel."""

LENGTH = 1e-4
"""Slid distance (m) over which the texture under a taxel becomes another: paper, cloth, wood."""


class Texture:
    """The texture under one array.

    Attributes:
        gains: (rows, columns), by which the force on each taxel differs (-).
    """

    def __init__(self, shape: tuple[int, int], rng: np.random.Generator, share: float) -> None:
        """Draw what lies under the taxels.

        Args:
            shape: Rows and columns.
            rng: Its random numbers.
            share: Standard deviation of the gains (-); 0 for a polished object.
        """
        self._rng, self._share = rng, share
        self._state = rng.standard_normal(shape)
        self.gains: FloatArray = 1.0 + share * self._state

    def slide(self, distance: float) -> None:
        """Slide the object over the pad by a distance (m)."""
        if distance <= 0.0 or self._share == 0.0:
            return
        kept = math.exp(-distance / LENGTH)
        fresh = self._rng.standard_normal(self._state.shape)
        self._state = kept * self._state + math.sqrt(1.0 - kept * kept) * fresh
        self.gains = np.maximum(1.0 + self._share * self._state, 0.0)
