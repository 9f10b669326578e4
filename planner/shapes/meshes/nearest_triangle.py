"""Exact nearest points of a triangle mesh, with outward normals that give the sign.

A tree of balls finds the triangle where kernels are compiled. Where they are not, coal's bounding
volume tree does; its triangle and all that share a corner with it are then measured in closed form,
because coal's tolerance of 1e-6 m could choose the wrong side of an edge.

The sign comes from the normal of the feature that the nearest point is on: of the face, the sum of
two faces' on an edge, the sum weighted by angles at a vertex (Baerentzen and Aanaes, "Signed
distance computation using the angle weighted pseudonormal", 2005), exact for closed meshes.

``BallTree``: balls around ever fewer triangles, in flat arrays for compiled loops. Node i has the
children 2 i + 1 and 2 i + 2. All leaves are at one depth and hold about equally many triangles:
each node is halved across the side along which its triangles are spread most.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import chain
from typing import Any

import coal
import numpy as np

from planner.numerics.kernels import kernels_are_compiled
from planner.shapes.meshes.triangles import COVERED, FACE, cover, nearest_on_triangles
from planner.spatial import FloatArray, IntArray

LEAF = 6
"""Most triangles of a leaf."""


@dataclass(frozen=True, kw_only=True, eq=False)
class BallTree:
    """The triangles of a mesh and the balls around them; m triangles, n nodes.

    Attributes:
        corners: Of the triangles (m, 3 corners, 3), m, one leaf after the other.
        numbers: Which triangle of the mesh each of them is (m,).
        balls: Centre and radius (m, 4), m, of a ball around each triangle.
        nodes: The same (n, 4) around the triangles of each node.
        first: Where the triangles of each leaf begin (leaves + 1,).
    """

    corners: FloatArray
    numbers: IntArray
    balls: FloatArray
    nodes: FloatArray
    first: IntArray

    @property
    def arrays(self) -> tuple[FloatArray, FloatArray, FloatArray, IntArray]:
        """What loops take: ``corners``, ``balls``, ``nodes``, ``first``."""
        return self.corners, self.balls, self.nodes, self.first

    @classmethod
    def of(cls, corners: FloatArray) -> BallTree:
        """The tree of triangles (m, 3 corners, 3), m."""
        m = len(corners)
        depth = max(0, int(np.ceil(np.log2(m / LEAF))))
        numbers = np.arange(m)
        lower, upper = corners.min(axis=1), corners.max(axis=1)
        middles = (lower + upper) / 2
        for level in range(depth):
            numbers = numbers[_halving(middles[numbers], _firsts(m, level))]
        first = _firsts(m, depth)
        ordered = np.ascontiguousarray(corners[numbers])
        balls = _around_boxes(ordered.reshape(-1, 3), np.arange(0, 3 * m + 1, 3))
        rows = [_around_boxes(ordered.reshape(-1, 3), 3 * first)]
        low = np.minimum.reduceat(lower[numbers], first[:-1])
        high = np.maximum.reduceat(upper[numbers], first[:-1])
        for _ in range(depth):
            low = np.minimum(low[::2], low[1::2])
            high = np.maximum(high[::2], high[1::2])
            rows.append(_around_children(rows[-1], low, high))
        return cls(
            corners=ordered, numbers=numbers, balls=balls, nodes=np.vstack(rows[::-1]), first=first
        )


def _firsts(m: int, level: int) -> IntArray:
    """Where the nodes of a level begin among m triangles, (2**level + 1,)."""
    return np.asarray((np.arange(2**level + 1) * m) >> level)


def _halving(middles: FloatArray, first: IntArray) -> IntArray:
    """An order (m,) that sorts the points (m, 3) of each part along its longest side."""
    low = np.minimum.reduceat(middles, first[:-1])
    spread = np.maximum.reduceat(middles, first[:-1]) - low
    along = np.argmax(spread, axis=1)
    part = np.repeat(np.arange(len(along)), np.diff(first))
    rows = np.arange(len(along))
    length = np.maximum(spread[rows, along], TINY)
    share = (middles[np.arange(len(middles)), along[part]] - low[rows, along][part]) / length[part]
    return np.argsort(part + share / 2, kind="stable")


TINY = 1e-300
"""Length (m) of a part whose triangles are all in one place."""

ROUNDING = 1.0 + 1e-12
"""Factor by which radii are enlarged, so that rounding leaves nothing outside."""


def _around_boxes(points: FloatArray, first: IntArray) -> FloatArray:
    """Balls (k, 4) about the middles of the boxes around parts of points (n, 3)."""
    middle = (np.minimum.reduceat(points, first[:-1]) + np.maximum.reduceat(points, first[:-1])) / 2
    gaps = points - np.repeat(middle, np.diff(first), axis=0)
    squares = np.maximum.reduceat(np.einsum("nd,nd->n", gaps, gaps), first[:-1])
    return np.column_stack([middle, np.sqrt(squares) * ROUNDING])


def _around_children(balls: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray:
    """Balls (k, 4) around two balls each and around a box each: the smaller of the two."""
    middle = (low + high) / 2
    gaps = balls[:, :3] - np.repeat(middle, 2, axis=0)
    reach = (np.sqrt(np.einsum("nd,nd->n", gaps, gaps)) + balls[:, 3]).reshape(-1, 2).max(axis=1)
    corner = np.linalg.norm(high - low, axis=1) / 2
    return np.column_stack([middle, np.minimum(reach, corner) * ROUNDING])


COVER_POINTS = 5_000
"""Points on the surface, about, by which the triangles around a point are found."""


class NearestTriangles:
    """Nearest points of a closed, consistently wound mesh.

    Attributes:
        faces: (m, 3), indices of the vertices.
        corners: (m, 3 corners, 3), m.
        areas: (m,), m2.
        normals: Outward unit normals (m, 3) of the faces; zero where a face has no area.
        neighbours: (m, 3), see ``edge_table``.
        feature_normals: Outward normals (m, 7, 3), not of unit length, of each triangle's corners,
            edges and face.
        at_vertex: Triangles at the vertices, one vertex after the other.
        tree: See ``coal_tree``.
        first_at_vertex: Where those of each vertex begin in it, (n + 1,).
    """

    def __init__(self, vertices: FloatArray, faces: IntArray) -> None:
        """Build coal's tree and the normals of faces, edges and vertices."""
        self.faces = faces
        self.corners = vertices[faces]
        cross = np.cross(
            self.corners[:, 1] - self.corners[:, 0], self.corners[:, 2] - self.corners[:, 0]
        )
        twice = np.linalg.norm(cross, axis=1)
        self.areas = twice / 2
        self.normals = cross / np.where(twice > 0, twice, 1.0)[:, None]
        self.neighbours = edge_table(faces)
        self.feature_normals = self._all_feature_normals(len(vertices))
        # the triangles at each vertex, one vertex after the other
        order = np.argsort(faces.ravel(), kind="stable")
        self.at_vertex = order // 3
        self.first_at_vertex = np.searchsorted(faces.ravel()[order], np.arange(len(vertices) + 1))
        self.tree, self._probe = coal_tree(vertices, faces), coal.Sphere(0.0)
        self._distance = coal.ComputeDistance(self.tree, self._probe)
        self._step = float(np.sqrt(self.areas.sum() / COVER_POINTS))

    @cached_property
    def _cover(self) -> tuple[Any, IntArray]:
        """A k-d tree of points that cover the triangles, and the triangle (k,) of each."""
        from scipy.spatial import cKDTree  # here, since SciPy loads slowly

        points, owner = cover(self.corners, self._step)
        return cKDTree(points), owner

    @cached_property
    def ball_tree(self) -> BallTree:
        """Balls around ever fewer triangles, made when first needed."""
        return BallTree.of(self.corners)

    @cached_property
    def _tree(self) -> tuple[FloatArray, IntArray, FloatArray, FloatArray, IntArray]:
        tree = self.ball_tree
        return tree.corners, tree.numbers, tree.balls, tree.nodes, tree.first

    def _all_feature_normals(self, n_vertices: int) -> FloatArray:
        """Normals (m, 7 features, 3), not of unit length."""
        out = np.empty((len(self.faces), FACE + 1, 3))
        edges = np.roll(self.corners, -1, axis=1) - self.corners
        length = np.linalg.norm(edges, axis=2, keepdims=True)
        unit = edges / np.where(length > 0, length, 1.0)
        cosines = -np.einsum("mkd,mkd->mk", unit, np.roll(unit, 1, axis=1))
        angles = np.arccos(np.clip(cosines, -1.0, 1.0))
        at_vertex = np.zeros((n_vertices, 3))
        for k in range(3):
            np.add.at(at_vertex, self.faces[:, k], angles[:, k, None] * self.normals)
        out[:, :3] = at_vertex[self.faces]
        out[:, 3:FACE] = self.normals[:, None] + self.normals[self.neighbours]
        out[:, FACE] = self.normals
        return out

    def nearest(self, points: FloatArray) -> tuple[FloatArray, IntArray, FloatArray]:
        """Nearest surface points (n, 3), m, their triangles (n,), outward normals (n, 3) there.

        The normals are those of face, edge or vertex, not of unit length.

        Args:
            points: (n, 3), m, finite.
        """
        if kernels_are_compiled():
            from planner.shapes.meshes.nearest_kernels import nearest_triangles

            surface, triangle, feature = nearest_triangles(
                np.ascontiguousarray(points, dtype=np.float64), *self._tree
            )
            return surface, triangle, self.feature_normals[triangle, feature]
        return self.nearest_around(points, self._by_coal(points))

    def nearest_around(
        self, points: FloatArray, guess: IntArray
    ) -> tuple[FloatArray, IntArray, FloatArray]:
        """As ``nearest``, among a triangle (n,) for each point and all that share a corner."""
        corners = self.faces[guess]
        counts = self.first_at_vertex[corners + 1] - self.first_at_vertex[corners]  # (n, 3)
        begin = np.repeat(self.first_at_vertex[corners].ravel(), counts.ravel())
        offset = np.arange(len(begin)) - np.repeat(
            np.cumsum(counts.ravel()) - counts.ravel(), counts.ravel()
        )
        candidate = self.at_vertex[begin + offset]
        row = np.repeat(np.arange(len(points)), counts.sum(axis=1))
        q, feature = nearest_on_triangles(points[row], self.corners[candidate])
        squares = ((points[row] - q) ** 2).sum(axis=1)
        order = np.lexsort((candidate, squares, row))
        best = order[np.searchsorted(row[order], np.arange(len(points)))]
        triangle = candidate[best]
        return q[best], triangle, self.feature_normals[triangle, feature[best]]

    def _by_coal(self, points: FloatArray) -> IntArray:
        request, result = coal.DistanceRequest(), coal.DistanceResult()
        identity, pose = coal.Transform3s.Identity(), coal.Transform3s.Identity()
        out = np.empty(len(points), dtype=np.int64)
        for i, p in enumerate(points):
            pose.setTranslation(p)
            result.clear()
            self._distance(identity, pose, request, result)
            out[i] = result.b1
        return out

    def within(self, points: FloatArray, radius: float) -> tuple[IntArray, IntArray]:
        """Triangles that come within a distance (m) of points (n, 3): numbers of both, (k,) each.

        Sorted by point, then by triangle.
        """
        if kernels_are_compiled():
            from planner.shapes.meshes.nearest_kernels import triangles_within

            points = np.ascontiguousarray(points, dtype=np.float64)
            owner, triangle = triangles_within(points, float(radius), *self._tree)
            order = np.argsort(owner * len(self.faces) + triangle)
            return owner[order], triangle[order]
        if len(points) * len(self.faces) <= FEW:
            owner, candidate = self._around_middles(points, radius)
        else:
            owner, candidate = self._around_covers(points, radius)
        q, _ = nearest_on_triangles(points[owner], self.corners[candidate])
        near = ((q - points[owner]) ** 2).sum(axis=1) <= radius**2
        return owner[near], candidate[near]

    @cached_property
    def _middles(self) -> tuple[FloatArray, FloatArray]:
        """Centre (m, 3) of each triangle, m, and how far its corners are from it (m,), m."""
        middles = self.corners.mean(axis=1)
        squares = ((self.corners - middles[:, None]) ** 2).sum(axis=2).max(axis=1)
        return middles, np.sqrt(squares)

    def _around_middles(self, points: FloatArray, radius: float) -> tuple[IntArray, IntArray]:
        """Pairs of a point and a triangle (k,) each that may be near, each triangle looked at."""
        middles, reach = self._middles
        most = ((reach + radius) * ROUNDING) ** 2
        found = [np.flatnonzero(((middles - p) ** 2).sum(axis=1) <= most) for p in points]
        owner = np.repeat(np.arange(len(points)), [len(row) for row in found])
        return owner, np.concatenate([np.zeros(0, dtype=np.int64), *found])

    def _around_covers(self, points: FloatArray, radius: float) -> tuple[IntArray, IntArray]:
        """The same by the tree of covering points."""
        tree, cover_owner = self._cover
        found = tree.query_ball_point(points, radius + COVERED * self._step)
        counts = [len(row) for row in found]
        owner = np.repeat(np.arange(len(points)), counts)
        covers = np.fromiter(chain.from_iterable(found), dtype=np.int64, count=sum(counts))
        pairs = np.unique(owner * len(self.faces) + cover_owner[covers])
        return np.divmod(pairs, len(self.faces))


FEW = 100_000
"""Pairs of a point and a triangle up to which every triangle is looked at: 5 ms at 50 ns a pair.
The tree of covering points takes 0.5 ms a point, but first a microsecond per triangle to be built,
and 0.3 s for SciPy's module."""


def coal_tree(vertices: FloatArray, faces: IntArray) -> Any:
    """The triangles as a ``coal.BVHModelOBBRSS``, which has no inside."""
    tree = coal.BVHModelOBBRSS()
    tree.beginModel(len(faces), len(vertices))
    tree.addVertices(np.ascontiguousarray(vertices, dtype=np.float64))
    tree.addTriangles(np.ascontiguousarray(faces, dtype=np.int64))
    tree.endModel()
    return tree


def edge_table(faces: IntArray) -> IntArray:
    """The triangle across each edge, (m, 3): of the edge from corner k to corner k + 1.

    Every edge must be of exactly two triangles that run through it in opposite directions.
    """
    n = int(faces.max()) + 1
    tail, head = faces, np.roll(faces, -1, axis=1)
    forward, backward = (tail * n + head).ravel(), (head * n + tail).ravel()
    order = np.argsort(forward)
    across: IntArray = (order[np.searchsorted(forward[order], backward)] // 3).reshape(-1, 3)
    return across
