"""Exact geometry of single triangles: nearest points, winding numbers, crossings, covering points.

Everything is vectorised over pairs or points, in m, and knows nothing of meshes and their topology.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner.spatial import FloatArray, IntArray

FACE = 6
"""Feature of a nearest point in the face; 0, 1, 2 are corners, 3 + k the edge from corner k."""

CHUNK = 1_000_000
"""Pairs of point and triangle that are held in memory at once: some 300 MB."""


def nearest_on_triangles(points: FloatArray, corners: FloatArray) -> tuple[FloatArray, IntArray]:
    """The point of each triangle that is nearest to each point.

    Args:
        points: (n, 3), m.
        corners: (n, 3 corners, 3), m; a triangle may be degenerate.

    Returns:
        Nearest points (n, 3), m, and the features (n,) that they are on, see ``FACE``.
    """
    edges = corners[:, _NEXT] - corners  # (n, 3 edges, 3)
    to_point = points[:, None] - corners
    squares = np.einsum("nkd,nkd->nk", edges, edges)
    along = np.einsum("nkd,nkd->nk", to_point, edges)
    t = np.minimum(np.maximum(along / np.where(squares > 0, squares, 1.0), 0.0), 1.0)
    on_edges = corners + t[:, :, None] * edges
    gaps = points[:, None] - on_edges
    row = np.arange(len(points))
    edge = np.argmin(np.einsum("nkd,nkd->nk", gaps, gaps), axis=1)
    nearest, share = on_edges[row, edge], t[row, edge]
    feature = np.where(share <= 0, edge, np.where(share >= 1, (edge + 1) % 3, edge + 3))
    normal = _cross(edges[:, 0], edges[:, 1])
    area = np.einsum("nd,nd->n", normal, normal)
    # over the face: on the inner side of all three edges
    inner = np.einsum("nkd,nkd->nk", _cross(normal[:, None], edges), to_point)
    over = (inner > 0).all(axis=1) & (area > 0)
    height = np.einsum("nd,nd->n", to_point[:, 0], normal) / np.where(area > 0, area, 1.0)
    nearest[over] = (points - height[:, None] * normal)[over]
    feature[over] = FACE
    return nearest, feature.astype(np.int64)


_NEXT = [1, 2, 0]
"""The corner after each."""


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """``np.cross`` of (..., 3) and (..., 3), a quarter of its time for few vectors."""
    return a[..., [1, 2, 0]] * b[..., [2, 0, 1]] - a[..., [2, 0, 1]] * b[..., [1, 2, 0]]


def winding_number(points: FloatArray, corners: FloatArray) -> FloatArray:
    """How often the triangles surround each point (n,): 1 inside, 0 outside of a closed solid.

    The sum of the signed solid angles, each exact (Van Oosterom and Strackee, "The solid angle of a
    plane triangle", 1983), divided by 4 pi. Not defined on the surface itself.

    Args:
        points: (n, 3), m.
        corners: (m, 3 corners, 3), m, wound counter-clockwise seen from outside.
    """
    out = np.zeros(len(points))
    step = max(1, CHUNK // max(1, len(corners)))
    for start in range(0, len(points), step):
        part = slice(start, start + step)
        seen = solid_angles(corners[None] - points[part, None, None])
        out[part] = seen.sum(axis=1) / (4 * np.pi)
    return out


def solid_angles(corners: FloatArray) -> FloatArray:
    """Signed solid angles (...), sr, of triangles (..., 3 corners, 3), m, seen from the origin.

    Positive where they run clockwise as seen: from inside of an outward surface.
    """
    a, b, c = (corners[..., k, :] for k in range(3))
    la, lb, lc = (np.sqrt(np.einsum("...d,...d->...", v, v)) for v in (a, b, c))
    above = np.einsum("...d,...d->...", a, np.cross(b, c))
    below = la * lb * lc
    for u, v, w in ((a, b, lc), (b, c, la), (c, a, lb)):
        below += np.einsum("...d,...d->...", u, v) * w
    angles: FloatArray = 2 * np.arctan2(above, below)
    return angles


def crossings(starts: FloatArray, ends: FloatArray, corners: FloatArray) -> NDArray[np.bool_]:
    """Whether each segment passes through the inside of its triangle, (n,) bool.

    A segment that only touches the rim, or lies in the plane, does not.

    Args:
        starts: (n, 3), m.
        ends: (n, 3), m.
        corners: (n, 3 corners, 3), m.
    """
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = normal / np.where(length > 0, length, 1.0)
    h0 = np.einsum("nd,nd->n", starts - corners[:, 0], normal)
    h1 = np.einsum("nd,nd->n", ends - corners[:, 0], normal)
    through: NDArray[np.bool_] = (h0 * h1 < 0) & (np.minimum(np.abs(h0), np.abs(h1)) > TOUCHING)
    share = h0 / np.where(through, h0 - h1, 1.0)
    hit = starts + share[:, None] * (ends - starts)
    for k in range(3):
        edge = corners[:, (k + 1) % 3] - corners[:, k]
        size = np.linalg.norm(edge, axis=1)
        inward = np.einsum("nd,nd->n", np.cross(normal, edge), hit - corners[:, k])
        through &= inward > TOUCHING * size
    return through


TOUCHING = 1e-9
"""Depth (m) up to which triangles that meet count as touching, not as crossing: rounding."""


def cover(corners: FloatArray, step: float) -> tuple[FloatArray, IntArray]:
    """Points on triangles such that no point of a triangle is farther than ``COVERED`` steps away.

    Rows run along the longest edge; a needle takes as many points as its length needs, no more.

    Args:
        corners: (n, 3 corners, 3), m.
        step: Spacing of the points, m.

    Returns:
        Points (m, 3), m, and the triangle (m,) that each is on; at least one each.
    """
    edges = np.roll(corners, -1, axis=1) - corners
    longest = np.argmax(np.einsum("nkd,nkd->nk", edges, edges), axis=1)
    row = np.arange(len(corners))
    origin, base = corners[row, longest], edges[row, longest]
    apex = corners[row, (longest + 2) % 3] - origin
    length = np.linalg.norm(base, axis=1)
    along = base / np.where(length > 0, length, 1.0)[:, None]
    foot = np.einsum("nd,nd->n", apex, along)  # where the apex is along the longest edge
    up = apex - foot[:, None] * along
    height = np.linalg.norm(up, axis=1)
    up = up / np.where(height > 0, height, 1.0)[:, None]
    n_rows = np.maximum(1, np.ceil(height / step)).astype(np.int64)
    owner = np.repeat(row, n_rows)
    j = _counting(n_rows)
    # each row takes the width of its lower rim, so that nothing beside the upper one is missed
    share = j / n_rows[owner]
    low, high = share * foot[owner], length[owner] - share * (length - foot)[owner]
    n_points = np.maximum(1, np.ceil((high - low) / step)).astype(np.int64)
    line = np.repeat(np.arange(len(owner)), n_points)
    owner = owner[line]
    x = low[line] + (_counting(n_points) + 0.5) / n_points[line] * (high - low)[line]
    before = x <= foot[owner]
    run = np.where(before, foot[owner], length[owner] - foot[owner])
    rise = np.where(before, x, length[owner] - x) / np.where(run > 0, run, 1.0)
    top = np.where(run > 0, rise, 1.0) * height[owner]
    y = np.minimum((j + 0.5)[line] / n_rows[owner] * height[owner], top)
    return origin[owner] + x[:, None] * along[owner] + y[:, None] * up[owner], owner


COVERED = 1.12
"""Half a step along a row and a whole one across, in steps: sqrt(0.25 + 1)."""


def _counting(counts: IntArray) -> IntArray:
    """0, 1, .. count - 1 for each of the counts, one after the other."""
    ends = np.cumsum(counts)
    out: IntArray = np.arange(int(ends[-1])) - np.repeat(ends - counts, counts)
    return out
