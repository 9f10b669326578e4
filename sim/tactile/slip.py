"""``SlipWatch``: which pads slip, from the shiver of their taxels.

While a pad sticks or rolls, what its taxels read over what a smooth patch at the estimated place
would give (``sim.tactile.pressure``) stays the same, taxel by taxel, up to noise: the texture under
each of them (``sim.tactile.texture``). Its logarithm, less what a wrong place or force explains
(constant and linear parts), is averaged over ``FAST`` and over ``SLOW``. The pad slips when the
mean square of their difference over the loaded taxels, less that of noise, exceeds ``ALARM``
squared and is larger than noise alone would make it once in millions (``SIGMAS``); it has stopped
when it falls below ``CALM`` squared.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planner.spatial import FloatArray
from sim.tactile.estimate import ContactEstimate
from sim.tactile.layout import TaxelLayout
from sim.tactile.pressure import contact_deviation, spread

__all__ = ["SlipWatch"]

FAST, SLOW = 0.015, 0.08
"""Time constants (s) of the averages that are compared."""

ALARM, CALM = 0.05, 0.03
"""Difference of the averages (-), as a share of a taxel's force, where a slip begins and ends."""

SIGMAS = 5.0
"""How unlikely noise alone must be, in standard deviations of a normal distribution: 3e-7."""

LOADED_SHARE = 0.005
"""Share of the normal force (-) from which on a taxel counts."""

FEWEST = 5
"""Loaded taxels below which nothing is left once place and force are taken out."""

LEAST_FORCE = 0.1
"""Normal force (N) below which a pad is too lightly loaded to tell."""

LEAST_NOISE = 0.01
"""Noise (-) that is expected of the best array."""

STEADY = 0.4
"""How far (-) the logarithm of the force may be from that of its slow average: where a patch grows
or shrinks faster, squeezing or letting go, nothing is judged."""

YOUNG = 10
"""Images that a taxel must have been loaded for before it counts."""


class SlipWatch:
    """Slips of n pads over time.

    Attributes:
        shiver: (n,), difference of the averages beyond noise (-), as a share of a taxel's force.
        slipping: (n,), which pads slip now.
    """

    def __init__(self, layouts: Sequence[TaxelLayout]) -> None:
        """Nothing slips yet.

        Args:
            layouts: Arrays of the pads.
        """
        n = len(layouts)
        self._pads = [_Pad(layout) for layout in layouts]
        self._taken = np.full(n, -np.inf)
        self.shiver = np.zeros(n)
        self.slipping: NDArray[np.bool_] = np.zeros(n, dtype=bool)

    def step(
        self, times: FloatArray, images: Sequence[FloatArray], seen: Sequence[ContactEstimate]
    ) -> None:
        """Take over images; one that has come before is left aside.

        Args:
            times: When they were taken, (n,), s.
            images: n arrays (rows, columns, 3), N.
            seen: The contact of each.
        """
        for k, (time, image) in enumerate(zip(times.tolist(), images, strict=True)):
            elapsed, self._taken[k] = time - self._taken[k], time
            if elapsed <= 0.0:
                continue
            excess, least = self._pads[k].look(min(elapsed, SLOW), image, seen[k])
            self.shiver[k] = np.sqrt(max(excess, 0.0))
            begins = excess > max(ALARM**2, least)
            self.slipping[k] = excess > CALM**2 if self.slipping[k] else begins


class _Pad:
    """The averages of one pad."""

    def __init__(self, layout: TaxelLayout) -> None:
        self._layout = layout
        rows, columns = layout.shape
        self._u, self._v = np.tile(layout.u, rows), np.repeat(layout.v, columns)
        self._noise = max(layout.array.noise, LEAST_NOISE)
        self._axes = layout.frames.reshape(-1, 3, 3).transpose(0, 2, 1)
        self._fast, self._slow = np.zeros((2, rows * columns))
        self._age = np.zeros(rows * columns)
        self._force = 0.0

    def look(self, elapsed: float, image: FloatArray, seen: ContactEstimate) -> tuple[float, float]:
        """Mean square of the difference beyond noise, and the most that noise explains (-)."""
        if seen.normal_force < LEAST_FORCE:
            self._age[:] = self._force = 0.0
            return 0.0, 0.0
        if self._force == 0.0:
            self._force = seen.normal_force
        self._force += elapsed / (SLOW + elapsed) * (seen.normal_force - self._force)
        if abs(math.log(seen.normal_force / self._force)) > STEADY:
            return 0.0, 0.0
        taxels = image.reshape(-1, 3)
        # along the contact's normal, not along each taxel's: of that the shear has no part
        pressure = ((self._axes @ seen.normal) * taxels).sum(axis=1)
        share = pressure / seen.normal_force
        deviation = contact_deviation(seen.normal_force, self._layout.radius)
        across, along = self._layout.edges
        smooth = np.outer(
            spread(along, seen.place[1], deviation), spread(across, seen.place[0], deviation)
        ).ravel()
        loaded = (
            (share > LOADED_SHARE)
            & (smooth > LOADED_SHARE)
            & (pressure > 2.0 * self._layout.array.threshold)
        )
        self._age = np.where(loaded, self._age + 1.0, 0.0)
        if int(loaded.sum()) < FEWEST:
            return 0.0, 0.0
        gain = np.log(share[loaded] / smooth[loaded])
        basis = np.stack(
            [
                np.ones(len(gain)),
                (self._u[loaded] - seen.place[0]) / deviation,
                (self._v[loaded] - seen.place[1]) / deviation,
            ]
        )
        gain = gain - basis.T @ np.linalg.solve(basis @ basis.T, basis @ gain)
        age = self._age[loaded]
        shares = [np.maximum(elapsed / (time + elapsed), 1.0 / age) for time in (FAST, SLOW)]
        for average, part in zip((self._fast, self._slow), shares, strict=True):
            average[loaded] += part * (gain - average[loaded])
        old = age > YOUNG
        count = int(old.sum())
        left = count - 3
        if count < FEWEST:
            return 0.0, 0.0
        fast, slow = (np.maximum(part / (2.0 - part), 1.0 / age) for part in shares)
        noise = self._noise**2 * float((fast + slow)[old].sum()) / count
        difference = (self._fast - self._slow)[loaded][old]
        square = float(difference @ difference) / left
        return square - noise, noise * (_unlikely(left) - 1.0)


def _unlikely(freedom: int) -> float:
    """What noise hardly ever exceeds: chi squared over its degrees of freedom at ``SIGMAS``.

    E. B. Wilson and M. M. Hilferty, The distribution of chi-square, PNAS 17, 1931.
    """
    part = 2.0 / (9.0 * freedom)
    return (1.0 - part + SIGMAS * math.sqrt(part)) ** 3
