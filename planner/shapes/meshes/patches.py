"""Triangles that pass through each other, cut out of a surface and filled in anew.

Where few triangles cross, mostly slivers that decimation folded over, the surface around them is
sound: they go, and the holes are closed with the least area. Where as many cross as before, the
vertices around them are drawn to the middle of their neighbours first, which unfolds them.
"""

from __future__ import annotations

import numpy as np

from planner.shapes.meshes.crossing import crossing_pairs, folded_pairs, near_pairs
from planner.shapes.meshes.holes import close_holes
from planner.shapes.meshes.soundness import bodies_of, paired_edges, undirected_edges
from planner.spatial import FloatArray, IntArray

ROUNDS = 40
"""Rounds of cutting or smoothing, at most; 94 crossings of a scan of 16,384 triangles need 12."""

PATIENCE = 4
"""Rounds of smoothing, after which the ring of vertices that move grows by one."""

ISLAND = 0.02
"""Share of all triangles below which what a cut leaves alone goes too."""

Triangles = tuple[FloatArray, IntArray]


def crossed_in_bodies(vertices: FloatArray, faces: IntArray) -> IntArray:
    """Triangles (k,) that cross, or lie on, others of their own body.

    Where edges are not of two triangles each: the triangles on such edges.
    """
    across = paired_edges(faces)
    if across is None:
        _, of_edge, counts = np.unique(
            undirected_edges(faces), return_inverse=True, return_counts=True
        )
        return np.flatnonzero((counts[of_edge].reshape(-1, 3) != 2).any(axis=1))
    corners, body = vertices[faces], bodies_of(faces)
    one, other = crossing_pairs(corners, near_pairs(vertices, faces))
    own = body[one] == body[other]
    folded = folded_pairs(corners, across)
    return np.unique(np.concatenate([one[own], other[own], *folded]))


def without_crossings(
    vertices: FloatArray, faces: IntArray, *, rounds: int = ROUNDS
) -> Triangles | None:
    """A surface whose bodies do not cross themselves; None if cutting and filling does not end.

    Args:
        vertices: (n, 3), m.
        faces: (m, 3), consistently wound, nearly all edges of two triangles each.
        rounds: Of cutting or smoothing, at most.
    """
    fewest, stuck = len(faces) + 1, 0
    for _ in range(rounds):
        faulty = crossed_in_bodies(vertices, faces)
        if len(faulty) == 0:
            return (vertices, faces) if paired_edges(faces) is not None else None
        if len(faulty) < fewest:
            fewest = len(faulty)
            filled = _cut_and_filled(vertices, faces, faulty)
            if filled is None:
                return None
            vertices, faces = filled
        else:
            vertices = _smoothed(vertices, faces, faulty, 1 + stuck // PATIENCE)
            stuck, fewest = stuck + 1, len(faces) + 1 if stuck % 2 else fewest
    return None


def _cut_and_filled(vertices: FloatArray, faces: IntArray, faulty: IntArray) -> Triangles | None:
    """Without the faulty triangles, and the holes closed; None if nothing would be left."""
    left = np.delete(faces, faulty, axis=0)
    if len(left) == 0:
        return None
    parts = bodies_of(left)
    large = np.bincount(parts) >= ISLAND * len(left)
    left = _without_pinches(left[large[parts]])
    vertices, faces, _ = close_holes(vertices, left, np.inf)
    used, faces = np.unique(faces, return_inverse=True)
    return vertices[used], faces.reshape(-1, 3)


def _smoothed(vertices: FloatArray, faces: IntArray, faulty: IntArray, rings: int) -> FloatArray:
    """Vertices of the faulty triangles, and of rings around them, amid their neighbours."""
    near = np.zeros(len(vertices), dtype=bool)
    near[faces[faulty]] = True
    for _ in range(rings - 1):
        near[faces[near[faces].any(axis=1)]] = True
    own = faces[near[faces].any(axis=1)]
    tail, head = (
        np.r_[own.ravel(), own[:, [1, 2, 0]].ravel()],
        np.r_[own[:, [1, 2, 0]].ravel(), own.ravel()],
    )
    count = np.bincount(tail, minlength=len(vertices))
    total = np.column_stack([np.bincount(tail, vertices[head, d], len(vertices)) for d in range(3)])
    out = vertices.copy()
    out[near] = total[near] / count[near, None]
    return out


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
