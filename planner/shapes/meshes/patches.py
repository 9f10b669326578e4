"""Triangles that pass through each other, cut out of a surface and filled in anew.

Where few triangles cross, mostly slivers that decimation folded over, the surface around them is
sound: they go, with more and more of their neighbours until what is left has simple rims, and the
holes are closed with the least area.
"""

from __future__ import annotations

import numpy as np

from planner.shapes.meshes.crossing import crossing_pairs, folded_pairs, near_pairs
from planner.shapes.meshes.edges import bodies_of, paired_edges
from planner.shapes.meshes.holes import close_holes
from planner.spatial import FloatArray, IntArray

__all__ = ["crossed_in_bodies", "without_crossings"]

ROUNDS = 8
"""Rounds of cutting and filling, each with one more ring of neighbours where it crosses still."""

ISLAND = 0.02
"""Share of all triangles below which what a cut leaves alone goes too."""

Triangles = tuple[FloatArray, IntArray]


def crossed_in_bodies(vertices: FloatArray, faces: IntArray) -> IntArray:
    """Triangles (k,) of a closed surface that cross, or lie on, others of their own body."""
    across = paired_edges(faces)
    if across is None:
        return np.zeros(0, dtype=np.int64)
    corners, body = vertices[faces], bodies_of(faces)
    one, other = crossing_pairs(corners, near_pairs(vertices, faces))
    own = body[one] == body[other]
    folded = folded_pairs(corners, across)
    return np.unique(np.concatenate([one[own], other[own], *folded]))


def without_crossings(vertices: FloatArray, faces: IntArray) -> Triangles | None:
    """A surface whose bodies do not cross themselves; None if cutting and filling does not end.

    Args:
        vertices: (n, 3), m.
        faces: (m, 3), of a closed surface, consistently wound.
    """
    crossed = crossed_in_bodies(vertices, faces)
    for ring in range(ROUNDS):
        if len(crossed) == 0:
            return vertices, faces
        cut = np.zeros(len(faces), dtype=bool)
        cut[crossed] = True
        for _ in range(1 + ring // 2):
            touched = np.zeros(len(vertices), dtype=bool)
            touched[faces[cut]] = True
            cut |= touched[faces].any(axis=1)
        if cut.all():
            return None
        left = faces[~cut]
        parts = bodies_of(left)
        large = np.bincount(parts) >= ISLAND * len(left)
        left = _without_pinches(left[large[parts]])
        vertices, faces, _ = close_holes(vertices, left, np.inf)
        used, faces = np.unique(faces, return_inverse=True)
        vertices, faces = vertices[used], faces.reshape(-1, 3)
        if paired_edges(faces) is None:
            return None
        crossed = crossed_in_bodies(vertices, faces)
    return None


def _without_pinches(faces: IntArray) -> IntArray:
    """Without the triangles at vertices in which rims meet, so that every rim is simple."""
    while True:
        tail, head = faces.ravel(), faces[:, [1, 2, 0]].ravel()
        n = int(faces.max()) + 1
        is_open = ~np.isin(tail * n + head, head * n + tail)
        pinched = np.bincount(tail[is_open], minlength=n) > 1
        bad = pinched[faces].any(axis=1)
        if not bad.any() or bad.all():
            return faces
        faces = faces[~bad]
