"""Fewer triangles for a page: vertices in one cell of a grid become one."""

from __future__ import annotations

import numpy as np

from planner.spatial import FloatArray, IntArray

__all__ = ["clustered", "simplified"]

ROUNDS = 12
"""Bisections of the grid's cell; the last ones change the number of triangles by 1 %."""


def simplified(
    vertices: FloatArray, triangles: IntArray, most: int
) -> tuple[FloatArray, IntArray, bool]:
    """A mesh of at most ``most`` triangles, and whether it is another one than was given.

    Args:
        vertices: (n, 3), m.
        triangles: (k, 3), numbers of vertices.
        most: Largest number of triangles.
    """
    if len(triangles) <= most:
        return vertices, triangles, False
    low, size = vertices.min(axis=0), float(np.ptp(vertices, axis=0).max())
    coarse, fine = size / 4, size / 4096
    best = clustered(vertices, triangles, low, coarse)
    for _ in range(ROUNDS):
        cell = float(np.sqrt(coarse * fine))
        candidate = clustered(vertices, triangles, low, cell)
        if len(candidate[1]) <= most:
            best, coarse = candidate, cell
        else:
            fine = cell
    return *best, True


def clustered(
    vertices: FloatArray, triangles: IntArray, low: FloatArray, cell: float
) -> tuple[FloatArray, IntArray]:
    """Each cell's vertices become their mean; triangles without area and doubles go.

    Args:
        vertices: (n, 3), m.
        triangles: (k, 3), numbers of vertices.
        low: Corner (3,) of the grid, below all vertices, m.
        cell: Edge of a cell, m.
    """
    at = np.floor((vertices - low) / cell).astype(np.int64)
    key = (at[:, 0] << 42) + (at[:, 1] << 21) + at[:, 2]
    _, number, counts = np.unique(key, return_inverse=True, return_counts=True)
    sums = np.column_stack([np.bincount(number, vertices[:, k]) for k in range(3)])
    means: FloatArray = sums / counts[:, None]
    new = number[triangles]
    has_area = (new[:, 0] != new[:, 1]) & (new[:, 1] != new[:, 2]) & (new[:, 2] != new[:, 0])
    new = new[has_area]
    _, first = np.unique(np.sort(new, axis=1), axis=0, return_index=True)
    return means, np.asarray(new[np.sort(first)], dtype=np.int64)
