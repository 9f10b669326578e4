"""Closed triangle surfaces woven from rings: rows of points about an axis, tubes, caps, branches.

A ring is a closed row of points; a surface is a stack of rings, wound so that normals point
outwards when a ring runs counter-clockwise about the direction of the stack.
"""

from __future__ import annotations

import numpy as np

from planner.spatial import FloatArray, IntArray

__all__ = ["Weave", "circle"]


def circle(n: int) -> FloatArray:
    """Cosines and sines (n, 2) of evenly spaced angles, from 0."""
    angle = 2 * np.pi * np.arange(n) / n
    return np.column_stack([np.cos(angle), np.sin(angle)])


class Weave:
    """Points and triangles in the making."""

    def __init__(self) -> None:
        """Nothing yet."""
        self._points: list[FloatArray] = []
        self._faces: list[IntArray] = []
        self._count = 0

    def add(self, points: FloatArray) -> IntArray:
        """Indices (n,) of new points (n, 3), m."""
        self._points.append(np.asarray(points, dtype=np.float64))
        first = self._count
        self._count += len(points)
        return np.arange(first, self._count)

    def stack(
        self, rings: FloatArray, *, closed: bool = False, without: IntArray | None = None
    ) -> IntArray:
        """Join rings (k, n, 3), m, one after the other; returns their indices (k, n).

        Args:
            rings: The rings.
            closed: Whether the last is joined to the first.
            without: Cells (m, 2) that are left open: ring and place in it.
        """
        k, n = rings.shape[:2]
        index = self.add(rings.reshape(-1, 3)).reshape(k, n)
        here = index if closed else index[:-1]
        above = np.roll(index, -1, axis=0) if closed else index[1:]
        keep = np.ones(here.shape, dtype=bool)
        if without is not None:
            keep[without[:, 0], without[:, 1]] = False
        self._quads(*(v[keep] for v in (here, np.roll(here, -1, 1), np.roll(above, -1, 1), above)))
        return index

    def join(self, ring: IntArray, following: IntArray) -> None:
        """Join two rings (n,) of the same count."""
        self._quads(ring, np.roll(ring, -1), np.roll(following, -1), following)

    def cap(self, ring: IntArray, tip: FloatArray, *, last: bool) -> None:
        """Close a ring (n,) with a fan to a tip (3,), at the end of a stack or at its start."""
        point = np.full(len(ring), self.add(tip[None])[0])
        sides = (ring, np.roll(ring, -1)) if last else (np.roll(ring, -1), ring)
        self._faces.append(np.column_stack([*sides, point]))

    def faces(self, corners: IntArray, index: IntArray) -> None:
        """Triangles (m, 3) by their places in a ring's indices (n,)."""
        self._faces.append(index[corners])

    def _quads(self, a: IntArray, b: IntArray, c: IntArray, d: IntArray) -> None:
        self._faces.append(np.column_stack([a, b, c]))
        self._faces.append(np.column_stack([a, c, d]))

    def around(
        self, index: IntArray, cells: IntArray, e1: FloatArray, e2: FloatArray
    ) -> tuple[IntArray, FloatArray]:
        """The rim of a block of open cells, counter-clockwise from e1 to e2, and its angles (rad).

        Args:
            index: Indices (k, n) that ``stack`` gave.
            cells: The cells (m, 2) that were left open, a rectangle.
            e1: (3,), direction of angle 0.
            e2: (3,), direction of angle pi / 2.
        """
        n = index.shape[1]
        used = np.zeros((len(index) - 1, n), dtype=bool)
        used[cells[:, 0], cells[:, 1]] = True
        # a point of the rim is a corner of one, two or three open cells, but not of four
        count = np.zeros(index.shape)
        for i, j in cells:
            for a, b in ((i, j), (i + 1, j), (i, (j + 1) % n), (i + 1, (j + 1) % n)):
                count[a, b] += 1
        rim = index[(count > 0) & (count < 4)]
        points = np.concatenate(self._points)[rim]
        from_middle = points - points.mean(axis=0)
        angle = np.mod(np.arctan2(from_middle @ e2, from_middle @ e1), 2 * np.pi)
        order = np.argsort(angle)
        return rim[order], angle[order]

    def triangles(self) -> tuple[FloatArray, IntArray]:
        """Points (n, 3), m, that are used, and triangles (m, 3)."""
        used, faces = np.unique(np.concatenate(self._faces), return_inverse=True)
        return np.concatenate(self._points)[used], faces.reshape(-1, 3)
