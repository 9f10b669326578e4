"""``FrictionWatch``: the friction of n pads, from how far their shear spreads.

Where a share (used) of the friction cone is in use, the shear is spread wider than the pressure by
(1 - (1 - used)^(5/3)) / used, 5/3 at no load and 1 at the edge (``sim.tactile.pressure``). With the
measured ratio r of tangential to normal force, used = r / mu: each image makes some mu likelier
than others. Their likelihoods are kept on a grid of mu and forgotten over ``MEMORY``. What slips
has all of its friction in use: r is mu then.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sim.tactile.estimate import ContactEstimate

GRID = np.geomspace(0.1, 2.0, 49)
"""Frictions (-) between which is chosen; neighbours differ by 6 %."""

MEMORY = 1.0
"""Time (s) over which images are forgotten: friction differs from place to place."""

SPREAD_NOISE = 0.25
"""Standard deviation (-) of the ratio of spreads in one image, at a tangential force as large as
the normal one; it grows as the tangential force shrinks."""

MOST_OFF = 3.0
"""Standard deviations (-) beyond which an image counts no more: two patches, the array's edge."""

RATIO_NOISE = 0.03
"""Standard deviation (-) of r, as a share of it."""


class FrictionWatch:
    """Friction of n pads over time.

    Attributes:
        friction: (n,), believed friction (-).
        deviation: (n,), its standard deviation (-).
        used: (n,), share of it in use (-), 0 to 1.
    """

    def __init__(self, spacings: Sequence[float]) -> None:
        """Nothing is known: all of the grid is as likely.

        Args:
            spacings: Of the taxels of each pad, m.
        """
        n = len(spacings)
        self._cell = np.array(spacings) ** 2 / 6.0  # spread of a cell itself, m2
        self._log = np.zeros((n, len(GRID)))
        self.used = np.zeros(n)
        self._believe()

    def step(
        self, elapsed: float, seen: Sequence[ContactEstimate], slipping: NDArray[np.bool_]
    ) -> None:
        """Take over the images of a time step.

        Args:
            elapsed: Since the last step, s.
            seen: One contact per pad.
            slipping: (n,), which of them slip.
        """
        ratio = np.array([one.friction_ratio for one in seen])
        shear = np.array([one.shear_spread for one in seen]) - self._cell
        pressure = np.array([one.pressure_spread for one in seen]) - self._cell
        self._log *= 1.0 - min(1.0, elapsed / MEMORY)
        known = np.isfinite(shear) & (pressure > 0) & (ratio > GRID[0] / 2)
        if known.any():
            share = ratio[:, None] / GRID
            used = np.clip(share, 1e-3, 1.0)
            wider = np.where(known, shear, 1.0) / np.where(known, pressure, 1.0)
            expected = (1.0 - (1.0 - used) ** (5.0 / 3.0)) / used
            off = (wider[:, None] - expected) * (ratio / SPREAD_NOISE)[:, None]
            over = np.where(slipping[:, None], share - 1.0, np.maximum(share - 1.0, 0.0))
            over = np.minimum(np.abs(over) / RATIO_NOISE, MOST_OFF)
            off = np.minimum(np.abs(off), MOST_OFF)
            self._log -= np.where(known[:, None], 0.5 * (off * off + over * over), 0.0)
            self._believe()
        self.used = np.clip(ratio / self.friction, 0.0, 1.0)

    def _believe(self) -> None:
        weight = np.exp(self._log - self._log.max(axis=1, keepdims=True))
        weight /= weight.sum(axis=1, keepdims=True)
        self.friction = weight @ GRID
        self.deviation = np.sqrt(np.maximum(weight @ GRID**2 - self.friction**2, 0.0))
