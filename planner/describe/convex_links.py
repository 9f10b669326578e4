"""Support and depth of convex link geometries: all that a pad is fitted from.

For a convex body K: support h(d) = max of d . x over K, depth(c) = least of h(d) - d . c over unit
d, the radius of the largest ball about c inside K.
"""

from __future__ import annotations

import numpy as np

from planner.bridge import LinkGeometry
from planner.spatial import FloatArray

ELLIPSOID_DIRECTIONS = 4000
"""Directions with which the depth in an ellipsoid is taken: at most 2 % of a radius too large where
its proportions are 1 to 3, and the verdict is coal's."""


class ConvexLink:
    """One convex geometry in the frame of the joint that carries it.

    Attributes:
        name: Name of the geom.
        kind: "sphere", "capsule", "cylinder", "box", "ellipsoid" or "mesh".
        center: (3,), m: its origin.
        rotation: (3, 3): its axes.
        vertices: (n, 3), of a mesh's hull, m, in its own axes, as all that follows.
        facets: (m, 4), outward unit normals and offsets of the hull's facets.
        points: (k, 3), the points that ``triangles`` counts.
        triangles: (m, 3), corners of the facets.
    """

    def __init__(self, geometry: LinkGeometry) -> None:
        """Take what is needed from a geometry; a mesh is its convex hull."""
        from scipy.spatial import ConvexHull  # here, since SciPy loads slowly

        self.name, self.kind, self.body = geometry.name, geometry.kind, geometry.body
        self.center = np.array(geometry.T_joint_geometry.translation)
        self.rotation = np.array(geometry.T_joint_geometry.rotation)
        self.size = geometry.size
        self.vertices = np.zeros((0, 3))
        self.facets = np.zeros((0, 4))
        self.points = np.zeros((0, 3))
        self.triangles = np.zeros((0, 3), dtype=np.int64)
        if self.kind == "mesh":
            hull = ConvexHull(np.array(geometry.geometry.points()))
            self.vertices = hull.points[hull.vertices]
            self.facets = hull.equations
            self.points, self.triangles = hull.points, hull.simplices

    def support_points(self, directions: FloatArray) -> FloatArray:
        """The furthest point of the body along each unit direction: (n, 3) -> (n, 3), m."""
        d = directions @ self.rotation
        a, b, c = (float(v) for v in self.size)
        if self.kind == "sphere":
            local = a * d
        elif self.kind == "capsule":
            local = a * d + np.outer(np.sign(d[:, 2]) * b, [0.0, 0.0, 1.0])
        elif self.kind == "cylinder":
            radial = d * [1.0, 1.0, 0.0]
            length = np.linalg.norm(radial, axis=1, keepdims=True)
            local = a * radial / np.maximum(length, 1e-12)
            local[:, 2] = np.sign(d[:, 2]) * b
        elif self.kind == "box":
            local = np.sign(d) * [a, b, c]
        elif self.kind == "ellipsoid":
            half = np.array([a, b, c])
            local = half**2 * d / np.linalg.norm(half * d, axis=1, keepdims=True)
        else:
            local = self.vertices[np.argmax(d @ self.vertices.T, axis=1)]
        return np.asarray(local @ self.rotation.T + self.center)

    def support(self, directions: FloatArray) -> FloatArray:
        """h(d) for unit directions (n, 3): (n,), m."""
        return np.asarray((self.support_points(directions) * directions).sum(axis=1))

    def depth(self, point: FloatArray) -> float:
        """Radius (m) of the largest ball about a point (3,) inside the body; negative outside."""
        x = self.rotation.T @ (point - self.center)
        a, b, c = (float(v) for v in self.size)
        if self.kind == "sphere":
            return a - float(np.linalg.norm(x))
        if self.kind == "capsule":
            return a - float(np.linalg.norm(x - [0.0, 0.0, np.clip(x[2], -b, b)]))
        if self.kind == "cylinder":
            return min(a - float(np.hypot(x[0], x[1])), b - abs(float(x[2])))
        if self.kind == "box":
            return float((np.array([a, b, c]) - np.abs(x)).min())
        if self.kind == "ellipsoid":
            d = sphere_directions(ELLIPSOID_DIRECTIONS)
            return float((np.linalg.norm(d * [a, b, c], axis=1) - d @ x).min())
        return float(-(self.facets[:, :3] @ x + self.facets[:, 3]).max())


def sphere_directions(count: int) -> FloatArray:
    """Unit vectors (count, 3) spread evenly over the sphere by the golden angle."""
    z = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    turn = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(count)
    radius = np.sqrt(1.0 - z**2)
    return np.column_stack([radius * np.cos(turn), radius * np.sin(turn), z])


def cone_directions(axis: FloatArray, half_angle: float, rings: int = 4) -> FloatArray:
    """Unit vectors (n, 3) on rings about a unit axis up to ``half_angle`` (rad), the axis first.

    Symmetric about the axis, so that what is averaged over them keeps a body's own symmetry.
    """
    side = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    side /= np.linalg.norm(side)
    across = np.cross(axis, side)
    out = [axis]
    for k in range(1, rings + 1):
        angle, count = half_angle * k / rings, 8 * k
        turns = 2 * np.pi * np.arange(count) / count
        ring = np.outer(np.cos(turns), side) + np.outer(np.sin(turns), across)
        out.extend(np.cos(angle) * axis + np.sin(angle) * ring)
    return np.array(out)
