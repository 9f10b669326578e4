"""Fewer triangles, to be looked at: vertices in one cell of a grid become one."""

from __future__ import annotations

import numpy as np

from planner.spatial import FloatArray, IntArray

ROUNDS = 8
"""Sizes of cells that are tried at most."""

ENOUGH = 0.85
"""Share of the allowed triangles that ends the search (-)."""

CELLS = 1 << 20
"""Cells along the longest side at most; three numbers of a cell fit into 63 bits."""


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
    # a surface of this area has about one vertex and two triangles per cell
    cell = float(np.sqrt(2.0 * _area(vertices, triangles) / most))
    finest, best = size / CELLS, None
    too_fine = 0.0
    for _ in range(ROUNDS):
        cell = max(cell, finest)
        kept, number = _cells(vertices, triangles, low, cell)
        if len(kept) <= most:
            best = (kept, number)
            if len(kept) >= ENOUGH * most:
                break
        else:
            too_fine = max(too_fine, cell)
        step = np.sqrt(max(len(kept), 1) / (0.95 * most))
        cell = max(cell * step, 1.02 * too_fine)
    if best is None:
        best = _cells(vertices, triangles, low, size)
    kept, number = best
    return _means(vertices, number), kept, True


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
    kept, number = _cells(vertices, triangles, low, cell)
    return _means(vertices, number), kept


def _means(vertices: FloatArray, number: IntArray) -> FloatArray:
    """Mean (c, 3) of the vertices of each cell."""
    sums = np.column_stack([np.bincount(number, vertices[:, k]) for k in range(3)])
    return np.asarray(sums / np.bincount(number)[:, None])


def _area(vertices: FloatArray, triangles: IntArray) -> float:
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()) / 2


def _cells(
    vertices: FloatArray, triangles: IntArray, low: FloatArray, cell: float
) -> tuple[IntArray, IntArray]:
    """Triangles (m, 3) between cells, no two alike, and the number of each vertex's cell (n,)."""
    at = np.floor((vertices - low) / cell).astype(np.int64)
    _, number = np.unique((at[:, 0] << 42) + (at[:, 1] << 21) + at[:, 2], return_inverse=True)
    new = number[triangles]
    new = new[(new[:, 0] != new[:, 1]) & (new[:, 1] != new[:, 2]) & (new[:, 2] != new[:, 0])]
    corners, n = np.sort(new, axis=1), int(number.max()) + 1
    _, first = np.unique((corners[:, 0] * n + corners[:, 1]) * n + corners[:, 2], return_index=True)
    return np.asarray(new[np.sort(first)], dtype=np.int64), number
