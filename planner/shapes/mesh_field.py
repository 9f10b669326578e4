"""The ``DistanceField`` of a mesh: its distance on nested grids, and bounds of it.

``Pyramid``: each grid has twice the spacing of the next finer one. The coarsest is measured as a
whole; on every finer one the nodes within ``NEAR`` of its spacings of the surface are measured, and
the others are interpolated from the coarser one, where the distance is smooth. So the work grows
with the area of the surface, and the number of nodes hardly matters.

``SurfaceWalk`` measures: fast, and almost exact. The nearest of many points spread over the surface
tells where to begin. From its triangle a walk leads over the edge or the vertex that the nearest
point is on, as long as that comes nearer. What is found is a nearest point of the triangles around
it, so its distance is an upper bound; the nearest of the spread points gives a lower one.
``NearestTriangles`` is exact, and the only one that a verdict may ask.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planner.shapes.distance_field import DistanceField
from planner.shapes.meshes.nearest_triangle import NearestTriangles
from planner.shapes.meshes.triangles import COVERED, FACE, cover
from planner.spatial import FloatArray, IntArray

if TYPE_CHECKING:
    from scipy.spatial import cKDTree


NEAR = (2, 3, 5, 5)
"""Nodes that are measured on the finest grid, the next one, and so on: those of which a point of
the surface is within so many spacings along each axis, and a few more. The last holds for all
coarser ones."""

BEGIN = 8
"""Spacing of the grid that is measured as a whole, in spacings of the first that is asked for."""

Measure = Callable[[FloatArray, bool], FloatArray]
"""Signed distance (n,), m, of points (n, 3), m, and whether they are near the surface."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Grid:
    """Values at the nodes of a grid; node k is at k times the spacing.

    Attributes:
        first: Index (3,) of the first node.
        spacing: m.
        values: (nx, ny, nz).
    """

    first: IntArray
    spacing: float
    values: FloatArray


class Pyramid:
    """Samples of a distance, from coarse grids to fine ones.

    Attributes:
        last: The grid that was asked for last; empty before.
        measured: (nx, ny, nz), which of its nodes were measured.
    """

    def __init__(self, measure: Measure, points: FloatArray, finest: float) -> None:
        """Begin without a grid.

        Args:
            measure: The distance.
            points: Points (k, 3) all over the surface, m, about a spacing of the finest grid apart
                or less.
            finest: Spacing of the finest grid that will be asked for, m.
        """
        self._measure, self._points, self._finest = measure, points, finest
        self.last = Grid(first=np.zeros(3, dtype=np.int64), spacing=0.0, values=np.zeros((0, 0, 0)))
        self.measured: NDArray[np.bool_] = np.zeros((0, 0, 0), dtype=bool)

    def sample(self, first: IntArray, shape: tuple[int, int, int], spacing: float) -> FloatArray:
        """Signed distance (nx, ny, nz), m, of the nodes of a grid.

        The spacing must be that of the grid before over a power of two, and the grid be within it
        but for a few nodes.

        Args:
            first: Index (3,) of the first node.
            shape: Counts of the nodes.
            spacing: m.
        """
        if not self.last.values.size:
            from planner.shapes.field_fit import grid_nodes  # here: of meshes that are not known

            h = spacing * BEGIN
            begin = first // BEGIN
            x, y, z = ((first + np.array(shape) - 1) // BEGIN + 2 - begin).tolist()
            whole = self._measure(grid_nodes(begin, (x, y, z), h), False)
            self.last = Grid(first=begin, spacing=h, values=whole.reshape(x, y, z))
        # what each grid on the way must hold for the next finer one to be interpolated
        wanted = [(first, np.array(shape))]
        for _ in range(round(np.log2(self.last.spacing / spacing)) - 1):
            lower, count = wanted[-1]
            upper = (lower + count - 1) // 2 + 3
            wanted.append((lower // 2 - 1, upper - lower // 2 + 1))
        for k, (lower, count) in reversed(list(enumerate(wanted))):
            self.last = self._finer(self.last, lower, count, spacing * 2**k)
        return self.last.values

    def _finer(self, coarse: Grid, first: IntArray, shape: IntArray, spacing: float) -> Grid:
        """The next grid: interpolated, and measured near the surface."""
        values = _interpolated(coarse, first, shape)
        cells = np.floor(self._points / spacing).astype(np.int64) - first
        halvings = min(round(np.log2(spacing / self._finest)), len(NEAR) - 1)
        self.measured = within_cells(cells, values.shape, NEAR[halvings])
        nodes: FloatArray = (np.argwhere(self.measured) + first) * np.float64(spacing)
        values[self.measured] = self._measure(nodes, halvings < 2)
        return Grid(first=first, spacing=spacing, values=values)


def within_cells(cells: IntArray, shape: tuple[int, ...], reach: int) -> NDArray[np.bool_]:
    """Nodes (nx, ny, nz) of which one of some cells is at most a number of nodes away, each axis.

    Cell k lies between nodes k and k + 1; both of them are one node away.

    Args:
        cells: (n, 3), counted from the first node; anywhere.
        shape: Counts of the nodes.
        reach: How many nodes, at least 1.
    """
    wide = tuple(s + 2 * reach for s in shape)
    inside = ((cells >= 1 - reach) & (cells < np.array(shape) + reach - 1)).all(axis=1)
    x, y, z = (cells[inside] + reach).T
    marks = np.zeros(wide, dtype=bool)
    marks.reshape(-1)[(x * wide[1] + y) * wide[2] + z] = True
    for axis in range(3):
        a = np.moveaxis(marks, axis, 0)
        n = len(a) - 2 * reach
        # node k takes what is in cells k - reach .. k + reach - 1
        parts = a[:n].copy()
        for shift in range(1, 2 * reach):
            parts |= a[shift : shift + n]
        marks = np.moveaxis(parts, 0, axis)
    return marks


def _interpolated(coarse: Grid, first: IntArray, shape: IntArray) -> FloatArray:
    """Values on a part of the grid of half the spacing, cubic along each axis.

    Where the coarse grid ends, it is continued by its last node.
    """
    lower = first // 2 - 1
    upper = (first + shape - 1) // 2 + 3  # beyond the last
    out = coarse.values
    for axis in range(3):
        have = np.arange(lower[axis], upper[axis]) - coarse.first[axis]
        a = np.moveaxis(out, axis, 0)[np.clip(have, 0, out.shape[axis] - 1)]
        fine = np.empty((2 * (len(a) - 3), *a.shape[1:]))
        fine[::2] = a[1:-2]
        fine[1::2] = (9 * (a[1:-2] + a[2:-1]) - (a[:-3] + a[3:])) / 16
        begin = first[axis] - 2 * (lower[axis] + 1)
        out = np.moveaxis(fine[begin : begin + shape[axis]], 0, axis)
    return np.ascontiguousarray(out)


CHUNK = 8192
"""Pairs of point and triangle that are measured at a time: their arrays stay in a core's cache."""

STEPS = 12
"""Most steps of a walk. Nearly all end after one or two; where triangles are much smaller than the
spread of the points, the last ones are no more than a few per cent off."""

NEARER = 1.0 - 1e-12
"""Share of the squared distance by which a step must come nearer: rounding is no progress."""


class SurfaceWalk:
    """Signed distances from a closed mesh, by a walk from the nearest of some points on it.

    Within some steps of walls and cracks thinner than a tenth of a step the sign may be wrong.

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
        distance = self._walked(points, triangle)
        if not near:
            self._put_outside(points, distance)
        return distance, np.maximum(least, 0.0)

    def _put_outside(self, points: FloatArray, distance: FloatArray) -> None:
        """Mend distances (n,) of points (n, 3) that are far in front of a thin wall, in place.

        A walk that begins on the back of the wall ends there, and sees a point inside. Few points
        of a coarse grid are inside, so each of them is looked at exactly.
        """
        inside = np.flatnonzero(distance < 0.0)
        if not len(inside):
            return
        at, _, outward = self._surface.nearest(points[inside])
        gaps = points[inside] - at
        wrong = (gaps * outward).sum(axis=1) > 0.0
        distance[inside[wrong]] = np.linalg.norm(gaps[wrong], axis=1)

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


STEP = 0.75
"""Spacing of the points on the surface from which walks begin, in spacings of the finest grid."""


def fit_mesh_field(
    surface: NearestTriangles, thickness: float, *, wall: float = np.inf
) -> DistanceField:
    """The field of a sound mesh whose centre of mass is at the origin.

    Args:
        surface: Its triangles.
        thickness: Of its walls, m, if it has thin ones: ``Mesh.wall_thickness``. It is smoothed by
            a share of that.
        wall: Thickness (m) that the finest grid is to resolve.
    """
    from planner.shapes.field_fit import finest_spacing, fit_field  # here: of unknown meshes

    corners = surface.corners.reshape(-1, 3)
    lower, upper = corners.min(axis=0), corners.max(axis=0)
    distance = _MeshDistance(surface, finest_spacing(lower, upper, wall)[0])
    return fit_field(
        distance.pyramid.sample,
        lower,
        upper,
        bracket=distance.bracket,
        smoothing=min(SMOOTHED_SHARE * thickness, SMOOTHED_MOST),
        wall=wall,
    )


SMOOTHED_SHARE = 0.2
"""Standard deviation of the smoothing over twice the volume by the area, which is the thickness of
a thin wall: walls, handles and shafts keep their place."""

SMOOTHED_MOST = 0.004
"""Largest standard deviation of the smoothing, m. Smoothing rounds edges, which keeps contacts off
them, and evens out the roughness of scans."""


class _MeshDistance:
    """Distances on grids of finer and finer spacing, and bounds of those on the last one."""

    def __init__(self, surface: NearestTriangles, finest: float) -> None:
        self._walk = SurfaceWalk(surface, STEP * finest)
        self.pyramid = Pyramid(self._measure, self._walk.points, finest)

    def _measure(self, points: FloatArray, near: bool) -> FloatArray:
        distance, self._least = self._walk.signed(points, near=near)  # bounds of the last grid
        return distance

    def bracket(
        self, first: IntArray, shape: tuple[int, int, int], h: float
    ) -> tuple[FloatArray, FloatArray]:
        """Bounds (nx, ny, nz), m, of the signed distance at nodes of the finest grid.

        A measured distance is that of a point of the surface, and has the right sign; the nearest
        point of those on the surface bounds it from below. Any other node is bounded by the cells
        that hold such points: every point of the surface is within ``gap`` of one of them.
        """
        from scipy.ndimage import distance_transform_edt  # here, since SciPy loads slowly

        last = self.pyramid.last
        box = tuple(slice(a, a + s) for a, s in zip(first - last.first, shape, strict=True))
        sample, measured = last.values[box], self.pyramid.measured[box]
        cells = np.floor(self._walk.points / h).astype(np.int64) - first
        to_band = h * distance_transform_edt(~within_cells(cells, shape, 1))
        least = np.maximum(to_band - self._walk.gap, 0.0)
        most = to_band + 3**0.5 * h
        kept = np.zeros(last.values.shape)
        kept[self.pyramid.measured] = self._least
        least = np.where(measured, np.maximum(least, kept[box]), least)
        most = np.where(measured, np.abs(sample), most)
        inside = sample < 0
        return np.where(inside, -most, least), np.where(inside, -least, most)
