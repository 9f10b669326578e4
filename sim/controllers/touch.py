"""``TouchReading``: what arrays of taxels read, one image per finger that takes part.

Made by ``sim.tactile``; read by whoever wants more than a ``PadReading``: policies, pictures.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planner.spatial import FloatArray

EXACT = "exact"
"""Name of the sense of touch without error."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TouchReading:
    """Images of n fingers; empty of a hand that has no taxels.

    Attributes:
        time: When each image was taken, (n,), s.
        images: n arrays (rows, columns, 3): force of each taxel on what touches it, N, in the
            taxel's own axes: outward, along the columns (around the bone), along the rows (along
            the bone).
    """

    time: FloatArray
    images: tuple[FloatArray, ...]

    @classmethod
    def nothing(cls) -> TouchReading:
        """The reading of a hand that has no taxels."""
        return cls(time=np.zeros(0), images=())
