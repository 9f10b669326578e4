"""Convex hulls, and triangles cut by a plane, for the decomposition into convex pieces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planner.spatial import FloatArray, IntArray

FLAT = 1e-12
"""Volume (m3) below which points span no solid: a cube of 0.1 mm. MuJoCo refuses such meshes."""

SURE = 1e-7
"""How deep (m) inside of all planes a point is counted as inside: rounding."""

STEP = 48
"""Planes per test; points outside one of them are not tested further."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Hull:
    """A convex polyhedron.

    Attributes:
        points: Its corners (n, 3), m.
        faces: (m, 3), counter-clockwise seen from outside.
        planes: (k, 4), outward unit normal and offset: n x + d <= 0 inside.
        volume: m3.
    """

    points: FloatArray
    faces: IntArray
    planes: FloatArray
    volume: float

    @property
    def triangles(self) -> FloatArray:
        """Corners (m, 3 corners, 3) of the faces, m."""
        triangles: FloatArray = self.points[self.faces]
        return triangles

    def inside(self, points: FloatArray) -> IntArray:
        """Indices of the points (n, 3) that are inside."""
        low, high = self.points.min(axis=0), self.points.max(axis=0)
        index = np.flatnonzero(((points > low) & (points < high)).all(axis=1))
        left = points[index]
        for start in range(0, len(self.planes), STEP):
            if len(left) == 0:
                break
            planes = self.planes[start : start + STEP]
            keep = (left @ planes[:, :3].T + planes[:, 3]).max(axis=1) < -SURE
            index, left = index[keep], left[keep]
        return index

    def depths(self, points: FloatArray) -> FloatArray:
        """How deep (n,), m, inside of the nearest plane points (n, 3) are."""
        depths: FloatArray = -(points @ self.planes[:, :3].T + self.planes[:, 3]).max(axis=1)
        return depths


def hull_of(points: FloatArray) -> Hull | None:
    """The convex hull of points (n, 3), m; None if they span no solid."""
    from scipy.spatial import ConvexHull, QhullError  # here, since SciPy loads slowly

    if len(points) < 4:
        return None
    try:
        hull = ConvexHull(points)
    except QhullError:
        return None
    if hull.volume < FLAT:
        return None
    number = np.zeros(len(points), dtype=np.int64)
    number[hull.vertices] = np.arange(len(hull.vertices))
    faces, normals = hull.simplices, hull.equations[:, :3]
    a, b, c = (points[faces[:, k]] for k in range(3))
    inward = np.einsum("nd,nd->n", np.cross(b - a, c - a), normals) < 0
    faces = np.where(inward[:, None], faces[:, ::-1], faces)
    return Hull(
        points=points[hull.vertices],
        faces=number[faces],
        planes=hull.equations,
        volume=float(hull.volume),
    )


def clip(triangles: FloatArray, normal: FloatArray, offset: float) -> FloatArray:
    """The part of triangles with normal x <= offset.

    A triangle that only touches the plane from beyond, or lies in it, is left out: of a solid, what
    is next to it on this side has the same corners.

    Args:
        triangles: (n, 3 corners, 3), m.
        normal: (3,).
        offset: m.

    Returns:
        Triangles (m, 3 corners, 3), m, of the same orientation.
    """
    height = _heights(triangles, normal, offset)
    some = height.min(axis=1) < 0
    triangles, height = triangles[some], height[some]
    kept = height <= 0
    count = kept.sum(axis=1)
    out = [triangles[count == 3]]
    for k in (1, 2):
        some = count == k
        corner, h = triangles[some], height[some]
        # turn each triangle so that the corner that is alone on its side comes first
        alone = np.argmax(kept[some] if k == 1 else ~kept[some], axis=1)
        order = (alone[:, None] + np.arange(3)) % 3
        row = np.arange(len(corner))[:, None]
        a, b, c = np.moveaxis(corner[row, order], 1, 0)
        ha, hb, hc = h[row, order].T
        ab = a + (ha / (ha - hb))[:, None] * (b - a)
        ac = a + (ha / (ha - hc))[:, None] * (c - a)
        if k == 1:
            out.append(np.stack([a, ab, ac], axis=1))
        else:
            out += [np.stack([ab, b, c], axis=1), np.stack([ab, c, ac], axis=1)]
    return np.concatenate(out)


def crossing_points(
    triangles: FloatArray, normal: FloatArray, offset: float, most: int
) -> FloatArray:
    """Where edges of triangles cross a plane, (m, 3), m; of about ``most`` triangles at most."""
    height = _heights(triangles, normal, offset)
    crossing = np.flatnonzero((height.min(axis=1) < 0) & (height.max(axis=1) > 0))
    crossing = crossing[:: max(1, len(crossing) // most)]
    corner, h = triangles[crossing], height[crossing]
    end, h_end = np.roll(corner, -1, axis=1), np.roll(h, -1, axis=1)
    through = h * h_end < 0
    share = h[through] / (h[through] - h_end[through])
    points: FloatArray = corner[through] + share[:, None] * (end[through] - corner[through])
    return points


def _heights(triangles: FloatArray, normal: FloatArray, offset: float) -> FloatArray:
    """Heights (n, 3) of corners above a plane, m; 0 where they are on it but for rounding."""
    height = triangles @ normal - offset
    height[np.abs(height) < SURE] = 0.0
    return height
