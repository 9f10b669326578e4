"""Signed distances of very many points from a triangle mesh, for its field: fast, and almost exact.

The nearest of many points spread over the surface tells where to begin. From its triangle a walk
leads over the edge or the vertex that the nearest point is on, as long as that comes nearer. What
is found is a nearest point of the triangles around it, so its distance is an upper bound; the
nearest of the spread points gives a lower one. ``NearestTriangles`` is exact, and the only one that
a verdict may ask.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from planner.shapes.meshes.nearest_triangle import NearestTriangles
from planner.shapes.meshes.triangles import COVERED, FACE, cover
from planner.spatial import FloatArray, IntArray

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

CHUNK = 8192
"""Pairs of point and triangle that are measured at a time: their arrays stay in a core's cache."""

STEPS = 12
"""Most steps of a walk. Nearly all end after one or two; where triangles are much smaller than the
spread of the points, the last ones are no more than a few per cent off."""

NEARER = 1.0 - 1e-12
"""Share of the squared distance by which a step must come nearer: rounding is no progress."""


class SurfaceWalk:
    """Signed distances from a closed mesh, by a walk from the nearest of some points on it.

    Attributes:
        points: Points (k, 3) spread over the surface, m.
        gap: No point of the surface is farther than this (m) from all of them.
    """

    def __init__(self, surface: NearestTriangles, step: float) -> None:
        """Spread the points.

        Args:
            surface: The mesh.
            step: Spacing of the points, m.
        """
        self._surface = surface
        points, owner = cover(surface.corners, step)
        self.gap = COVERED * step
        if len(points) > CROWDED * surface.areas.sum() / step**2:
            # triangles smaller than a step have a point each: keep one of each small cube
            one = _one_of_each_cube(points, THINNED * step)
            points, owner = points[one], owner[one]
            self.gap += 3**0.5 * THINNED * step
        few = _one_of_each_cube(points, FAR_THINNED * step)
        self._few_gap = self.gap + 3**0.5 * FAR_THINNED * step
        self.points, self._owner, self._few_owner = points, owner, owner[few]
        self._tree, self._few_tree = _tree(points), _tree(points[few])
        self._rows = _gram_rows(surface.corners)

    def signed(self, points: FloatArray, *, near: bool = True) -> tuple[FloatArray, FloatArray]:
        """Signed distances (n,), m, and lower bounds (n,) of their size.

        Args:
            points: (n, 3), m.
            near: Whether most points are near the surface. Where they are not, the search begins
                among few points: far away, many are about as near as the nearest.
        """
        if near:
            to_point, which = self._tree.query(points)
            triangle, least = self._owner[which], to_point - self.gap
        else:
            to_point, which = self._few_tree.query(points)
            triangle, least = self._few_owner[which], to_point - self._few_gap
            close = least < self._few_gap
            to_point, which = self._tree.query(points[close])
            triangle[close], least[close] = self._owner[which], to_point - self.gap
        return self._walked(points, triangle), np.maximum(least, 0.0)

    def _walked(self, points: FloatArray, triangle: IntArray) -> FloatArray:
        """Signed distances (n,), m, by walks from triangles (n,), which are overwritten."""
        gaps, squares, feature = self._measured(points, triangle)
        active = np.flatnonzero(feature != FACE)
        for _ in range(STEPS):
            if not len(active):
                break
            candidate, count = self._beyond(triangle[active], feature[active])
            row = np.repeat(active, count)
            their_gaps, their_squares, their_feature = self._measured(points[row], candidate)
            # of the triangles around a vertex, the nearest
            start = np.cumsum(count) - count
            least = np.minimum.reduceat(their_squares, start)
            best = np.flatnonzero(their_squares == np.repeat(least, count))
            best = best[np.searchsorted(best, start)]
            nearer = least < NEARER * squares[active]
            active, best = active[nearer], best[nearer]
            triangle[active], feature[active] = candidate[best], their_feature[best]
            gaps[:, active], squares[active] = their_gaps[:, best], their_squares[best]
            active = active[feature[active] != FACE]
        normals = self._surface.feature_normals[triangle, feature]
        outside = np.einsum("dn,nd->n", gaps, normals) >= 0
        distance = np.sqrt(squares)
        return np.where(outside, distance, -distance)

    def _measured(
        self, points: FloatArray, triangle: IntArray
    ) -> tuple[FloatArray, FloatArray, IntArray]:
        """Gaps (3, n) from the nearest points of triangles, their squares, the features (n,)."""
        n = len(points)
        gaps, squares, feature = np.empty((3, n)), np.empty(n), np.empty(n, dtype=np.int64)
        for begin in range(0, n, CHUNK):
            part = slice(begin, begin + CHUNK)
            rows = self._rows[triangle[part]].T.copy()
            gaps[:, part], squares[part], feature[part] = _nearest(points[part].T, rows)
        return gaps, squares, feature

    def _beyond(self, triangle: IntArray, feature: IntArray) -> tuple[IntArray, IntArray]:
        """Triangles across the edge, or around the vertex, that points are on; how many of each."""
        surface, at_corner = self._surface, feature < 3
        vertex = surface.faces[triangle, feature % 3]
        begin, end = surface.first_at_vertex[vertex], surface.first_at_vertex[vertex + 1]
        count = np.where(at_corner, end - begin, 1)
        offset = np.arange(int(count.sum())) - np.repeat(np.cumsum(count) - count, count)
        place = np.repeat(begin, count) + offset
        around = surface.at_vertex[np.minimum(place, len(surface.at_vertex) - 1)]
        across = np.repeat(surface.neighbours[triangle, feature % 3], count)
        return np.where(np.repeat(at_corner, count), around, across), count


CROWDED = 3.0
"""Points per square of a step from which on they are thinned out."""

THINNED = 0.5
"""Side of the cubes of which one point each is kept, in steps."""


FAR_THINNED = 2.0
"""Side of the cubes of which one point each is kept for points that are far away, in steps."""

LEAF = 32
"""Points in a leaf of the trees: fewer make queries slower."""


def _tree(points: FloatArray) -> cKDTree:
    from scipy.spatial import cKDTree  # here, since SciPy loads slowly

    return cKDTree(points, leafsize=LEAF, balanced_tree=False, compact_nodes=False)


def _one_of_each_cube(points: FloatArray, side: float) -> IntArray:
    """The number of one point (k,) in each cube of a side (m)."""
    cell = np.floor((points - points.min(axis=0)) / side).astype(np.int64)
    size = cell.max(axis=0) + 1
    _, one = np.unique(
        (cell[:, 0] * size[1] + cell[:, 1]) * size[2] + cell[:, 2], return_index=True
    )
    return np.asarray(one)


def _gram_rows(corners: FloatArray) -> FloatArray:
    """Corner a, edges e = b - a and f = c - a, and e.e, e.f, f.f of triangles: (m, 12)."""
    a, e, f = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    products = [np.einsum("nd,nd->n", u, v) for u, v in ((e, e), (e, f), (f, f))]
    return np.hstack([a, e, f, np.stack(products, axis=1)])


def _nearest(p: FloatArray, rows: FloatArray) -> tuple[FloatArray, FloatArray, IntArray]:
    """Gap (3, n) from the nearest point of each triangle to each point, square, feature (n,).

    The nearest point a + s e + t f is in the plane where 0 < s, 0 < t, s + t < 1, and else the best
    of the three edges.

    Args:
        p: (3, n), m.
        rows: Of the triangles, (12, n), see ``_gram_rows``.
    """
    d, e, f = p - rows[:3], rows[3:6], rows[6:9]
    ee, ef, ff = rows[9:]
    de = d[0] * e[0] + d[1] * e[1] + d[2] * e[2]
    df = d[0] * f[0] + d[1] * f[1] + d[2] * f[2]
    area = ee * ff - ef * ef
    s, t = ff * de - ef * df, ee * df - ef * de  # times the area
    over = (s > 0) & (t > 0) & (s + t < area)
    # shares of the edges a b, b c, c a, and the squares of the distances less d . d
    ab = np.clip(de / np.maximum(ee, TINY), 0.0, 1.0)
    ac = np.clip(df / np.maximum(ff, TINY), 0.0, 1.0)
    cb = np.clip((ff - ef - df + de) / np.maximum(ee - 2 * ef + ff, TINY), 0.0, 1.0)
    bc = 1.0 - cb
    on_ab, on_ac = ab * (ab * ee - 2 * de), ac * (ac * ff - 2 * df)
    on_bc = cb * (cb * ee + 2 * bc * ef - 2 * de) + bc * (bc * ff - 2 * df)
    by_ab = (on_ab <= on_ac) & (on_ab <= on_bc)
    by_ac = ~by_ab & (on_ac <= on_bc)
    safe = np.where(over, area, 1.0)
    s = np.where(over, s / safe, np.where(by_ab, ab, np.where(by_ac, 0.0, cb)))
    t = np.where(over, t / safe, np.where(by_ab, 0.0, np.where(by_ac, ac, bc)))
    gap = d - s * e - t * f
    corner = np.select([s >= 1.0, t >= 1.0, (s <= 0.0) & (t <= 0.0)], [1, 2, 0], default=-1)
    edge = np.where(by_ab, 3, np.where(by_ac, 5, 4))
    feature = np.where(over, FACE, np.where(corner >= 0, corner, edge))
    return gap, gap[0] ** 2 + gap[1] ** 2 + gap[2] ** 2, feature


TINY = 1e-300
"""Square (m2) of an edge without length."""
