"""``SlipWatch``: friction and slips of n pads, from what taxels and joints say over time.

Friction. Where a share (used) of the friction cone is in use, the shear is spread wider than the
pressure by (1 - (1 - used)^(5/3)) / used, 5/3 at no load and 1 at the edge (``pressure``). With the
measured ratio r of tangential to normal force, used = r / mu: each image makes some mu likelier
than others. Their likelihoods are kept on a grid of mu and forgotten over ``MEMORY``.

Slip. Two signs together: most of the friction is in use, and joints see the fingertip move over the
body that the other fingers hold (``sim.tactile.bodies``), by ``SLIP_DISTANCE`` within
``SLIP_WINDOW``. What slid at that moment had all of its friction in use, so r is the friction from
then on, which the grid takes over.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planner.spatial import FloatArray
from sim.tactile.estimate import ContactEstimate

__all__ = ["SlipWatch"]

GRID = np.geomspace(0.1, 2.0, 49)
"""Frictions (-) between which is chosen; neighbours differ by 6 %."""

MEMORY = 1.0
"""Time (s) over which images are forgotten: friction differs from place to place."""

SPREAD_NOISE = 0.1
"""Standard deviation (-) of the ratio of spreads of one image at a tangential as large as the
normal force; it grows as the tangential force shrinks."""

RATIO_NOISE = 0.03
"""Standard deviation (-) of r, as a share of it."""

SLIP_USED = 0.7
"""Share of the friction (-) in use from which on a pad can slip."""

SLIP_DISTANCE, SLIP_WINDOW = 8e-5, 0.1
"""Distance (m) that a pad slides within a time (s) when it slips."""


class SlipWatch:
    """Friction and slips of n pads.

    Attributes:
        friction: (n,), believed friction (-).
        used: (n,), share of it in use (-), 0 to 1.
        slipping: (n,), which pads slip now.
    """

    def __init__(self, n: int, spacings: Sequence[float]) -> None:
        """Nothing is known.

        Args:
            n: Number of pads.
            spacings: Of their taxels, m.
        """
        self._cell = np.array(spacings) ** 2 / 6.0  # spread of a cell itself, m2
        self._log = np.zeros((n, len(GRID)))
        self.friction = np.full(n, float(np.sqrt(GRID[0] * GRID[-1])))
        self.used = np.zeros(n)
        self.slipping: NDArray[np.bool_] = np.zeros(n, dtype=bool)
        self._slid: deque[tuple[float, FloatArray]] = deque()
        self._path = np.zeros((n, 3))
        self._since = 0.0

    def step(self, elapsed: float, seen: Sequence[ContactEstimate]) -> None:
        """Take over the images of a time step.

        Args:
            elapsed: Since the last step, s.
            seen: One contact per pad.
        """
        ratio = np.array([one.friction_ratio for one in seen])
        shear = np.array([one.shear_spread for one in seen]) - self._cell
        pressure = np.array([one.pressure_spread for one in seen]) - self._cell
        self._log *= 1.0 - min(1.0, elapsed / MEMORY)
        known = (pressure > 0) & np.isfinite(shear) & (ratio > 0.02)
        if known.any():
            wider = np.where(known, shear / np.where(known, pressure, 1.0), 1.0)
            used = np.clip(ratio[:, None] / GRID, 1e-3, 1.0)
            expected = (1.0 - (1.0 - used) ** (5.0 / 3.0)) / used
            off = (wider[:, None] - expected) * (ratio / SPREAD_NOISE)[:, None]
            over = np.maximum(ratio[:, None] / GRID - 1.0, 0.0) / RATIO_NOISE
            self._log -= np.where(known[:, None], 0.5 * (np.minimum(off * off, 9.0) + over**2), 0.0)
        self._believe()
        self.used = np.clip(ratio / self.friction, 0.0, 1.0)

    def _believe(self) -> None:
        weight = np.exp(self._log - self._log.max(axis=1, keepdims=True))
        self.friction = (weight @ GRID) / weight.sum(axis=1)
