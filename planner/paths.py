"""How a motion goes from one end to the other: a smooth profile of time, and places on a path."""

from __future__ import annotations

import numpy as np

from planner.spatial import FloatArray

__all__ = ["along", "smooth"]


def along(path: FloatArray, share: FloatArray) -> FloatArray:
    """Joints (k, n) at shares (k,) in [0, 1] of a path (m, n) of evenly spaced postures."""
    at = np.linspace(0.0, 1.0, len(path))
    return np.column_stack([np.interp(share, at, column) for column in path.T])


def smooth(s: FloatArray) -> FloatArray:
    """Minimum-jerk profile 10 s^3 - 15 s^4 + 6 s^5 of s in [0, 1]: at rest at both ends."""
    return s**3 * (10 + s * (6 * s - 15))
