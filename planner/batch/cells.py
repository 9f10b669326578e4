"""Cells of equal area on the sphere: the HEALPix grid in ring order.

Gorski et al., "HEALPix: a framework for high-resolution discretization and fast analysis of data
distributed on the sphere", The Astrophysical Journal 622 (2005), section 5 and appendix. Its cells
are compact and of exactly equal area, so that directions without preference fill them alike.
"""

from __future__ import annotations

import numpy as np

from planner.spatial import FloatArray, IntArray

__all__ = ["N_CELLS", "cell_of"]

N_SIDE = 4
"""Resolution: cells along the edge of each of the twelve base cells."""

N_CELLS = 12 * N_SIDE**2
"""Cells on the sphere: 192, each 0.065 sr, about 15 degrees across."""


def cell_of(directions: FloatArray) -> IntArray:
    """Number of the cell (n,), from 0 at the north pole, that each direction (n, 3) is in."""
    x, y, z = np.asarray(directions, dtype=np.float64).reshape(-1, 3).T
    z = z / np.sqrt(x * x + y * y + z * z)
    quarter = np.mod(np.arctan2(y, x), 2 * np.pi) / (np.pi / 2)  # azimuth, [0, 4)
    cells: IntArray = np.where(np.abs(z) <= 2 / 3, _belt(z, quarter), _cap(z, quarter))
    return cells


def _belt(z: FloatArray, quarter: FloatArray) -> IntArray:
    """Cells of the equatorial belt, where all rings have 4 N cells."""
    rising = np.floor(N_SIDE * (0.5 + quarter - 0.75 * z)).astype(np.int64)
    falling = np.floor(N_SIDE * (0.5 + quarter + 0.75 * z)).astype(np.int64)
    ring = N_SIDE + 1 + rising - falling  # 1 .. 2 N + 1
    place = ((rising + falling - N_SIDE + 1) // 2) % (4 * N_SIDE)
    cells: IntArray = 2 * N_SIDE * (N_SIDE - 1) + (ring - 1) * 4 * N_SIDE + place
    return cells


def _cap(z: FloatArray, quarter: FloatArray) -> IntArray:
    """Cells of the polar caps, where the ring i from the pole has 4 i cells."""
    share = quarter - np.floor(quarter)
    out = N_SIDE * np.sqrt(np.maximum(0.0, 3.0 * (1.0 - np.abs(z))))
    rising = np.floor(share * out).astype(np.int64)
    falling = np.floor((1.0 - share) * out).astype(np.int64)
    ring = np.minimum(rising + falling + 1, N_SIDE)
    place = np.floor(quarter * ring).astype(np.int64) % (4 * ring)
    north = 2 * ring * (ring - 1) + place
    cells: IntArray = np.where(z > 0, north, N_CELLS - 2 * ring * (ring + 1) + place)
    return cells
