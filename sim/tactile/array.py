"""``TaxelArray``: an array with noise, threshold, dead taxels, rate and latency.

Turns perfect images into those that arrive. Called by the sense ``taxels`` once a time step.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from planner.spatial import FloatArray
from sim.tactile.layout import TaxelLayout

TIME_TOL = 1e-9
"""Times that differ by less (s) are the same: rounding of sums of time steps."""


class TaxelArray:
    """One array over time.

    Attributes:
        layout: Its geometry and errors.
    """

    def __init__(self, layout: TaxelLayout, rng: np.random.Generator) -> None:
        """Nothing has been read.

        Args:
            layout: Its geometry and errors.
            rng: Of the noise.
        """
        self.layout = layout
        self._rng = rng
        self._alive = np.ones((*layout.shape, 1))
        for row, column in layout.array.dead:
            self._alive[row, column] = 0.0
        self._under_way: deque[tuple[float, FloatArray]] = deque()
        self._newest: tuple[float, FloatArray] = (0.0, np.zeros((*layout.shape, 3)))
        self._next = -math.inf

    def read(self, time: float, exact: FloatArray) -> tuple[float, FloatArray]:
        """When the newest image that has arrived was taken (s), and the image.

        Args:
            time: Now, s; never earlier than at the last call.
            exact: What perfect taxels would read now, (rows, columns, 3), N.
        """
        array = self.layout.array
        if time >= self._next - TIME_TOL:
            if array.rate > 0:
                self._next = (math.floor(time * array.rate + TIME_TOL) + 1) / array.rate
            self._under_way.append((time, self.measured(exact)))
        while self._under_way and self._under_way[0][0] <= time - array.latency + TIME_TOL:
            self._newest = self._under_way.popleft()
        return self._newest

    def measured(self, exact: FloatArray) -> FloatArray:
        """An image (rows, columns, 3) with noise, without what is below the threshold or dead."""
        array, image = self.layout.array, exact
        if array.noise > 0:
            deviation = array.noise * np.maximum(np.abs(exact[..., :1]), array.threshold)
            image = exact + deviation * self._rng.standard_normal(exact.shape)
        felt = np.abs(image[..., :1]) >= array.threshold
        return np.asarray(image * (felt * self._alive))
