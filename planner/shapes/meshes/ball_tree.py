"""``BallTree``: balls around ever fewer triangles of a mesh, in flat arrays for compiled loops.

Node i has the children 2 i + 1 and 2 i + 2. All leaves are at one depth and hold about equally many
triangles: each node is halved across the side along which its triangles are spread most.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

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
