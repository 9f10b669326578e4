"""The unit sphere of directions cut into spherical triangles, each into four smaller ones."""

from __future__ import annotations

from functools import cache

import numpy as np

from planner.spatial import FloatArray, IntArray


@cache
def icosphere(halvings: int) -> tuple[FloatArray, IntArray]:
    """Vertices (m, 3), unit, and triangles (k, 3) of an icosahedron, halved a number of times.

    The cones over the triangles fill space. 0 halvings: 12 and 20; 1: 42 and 80; 2: 162 and 320.
    """
    if halvings:
        vertices, triangles = icosphere(halvings - 1)
        found: dict[tuple[int, int], int] = {}
        fresh: list[FloatArray] = [*vertices]
        cells = []
        for a, b, c in triangles:
            middles = []
            for i, j in ((a, b), (b, c), (c, a)):
                key = (int(min(i, j)), int(max(i, j)))
                if key not in found:
                    found[key] = len(fresh)
                    middle = vertices[i] + vertices[j]
                    fresh.append(middle / np.linalg.norm(middle))
                middles.append(found[key])
            d, e, f = middles
            cells += [(a, d, f), (b, e, d), (c, f, e), (d, e, f)]
        return np.array(fresh), np.array(cells, dtype=np.int64)
    g = (1 + np.sqrt(5)) / 2
    corners = np.array(
        [(s, t * g, 0.0) for s in (-1, 1) for t in (-1, 1)]
        + [(0.0, s, t * g) for s in (-1, 1) for t in (-1, 1)]
        + [(t * g, 0.0, s) for s in (-1, 1) for t in (-1, 1)]
    )
    corners = corners / np.linalg.norm(corners[0])
    # Corners are neighbours where they are nearest; a face is three neighbours of each other.
    near = corners @ corners.T > 0.4
    faces = [
        (i, j, k)
        for i in range(12)
        for j in range(i + 1, 12)
        for k in range(j + 1, 12)
        if near[i, j] and near[j, k] and near[i, k]
    ]
    return corners, np.array(faces, dtype=np.int64)


def halved(triangle: FloatArray) -> FloatArray:
    """Four triangles (4, 3, 3) of unit corners that fill the cone over one (3, 3)."""
    a, b, c = triangle
    d, e, f = ((p + q) / np.linalg.norm(p + q) for p, q in ((a, b), (b, c), (c, a)))
    return np.array([(a, d, f), (b, e, d), (c, f, e), (d, e, f)])
