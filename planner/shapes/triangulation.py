"""A shape's surface as triangles and as evenly spread points, for any kind of shape."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from planner.errors import ObjectError
from planner.shapes.base import Shape
from planner.shapes.hulls import hull_of
from planner.shapes.mesh import Mesh
from planner.spatial import FloatArray, IntArray

FINENESS = 4
"""Subdivisions of the icosahedron in whose directions a convex shape is seen: 2562, 4 degrees
apart, so that chords of a sphere lie within 0.1 % of its radius."""

FAR = 100.0
"""From how far away (bounding radii) it is seen."""


def surface_triangles(shape: Shape) -> tuple[FloatArray, IntArray]:
    """Vertices (n, 3), m, and faces (m, 3), counter-clockwise from outside, of a shape.

    A mesh has its own. The other kinds are convex: the hull of the points nearest to far points all
    around, which are on the true surface.

    Raises:
        ObjectError: It is smaller than rounding.
    """
    import trimesh  # here, since trimesh loads slowly

    if isinstance(shape, Mesh):
        return shape.vertices, shape.faces
    directions = np.asarray(trimesh.creation.icosphere(subdivisions=FINENESS).vertices)
    points, _ = shape.closest_point(FAR * shape.bounding_radius * directions)
    hull = hull_of(points)
    if hull is None:
        raise ObjectError(f"{shape.spec} is too small to have a surface of triangles; enlarge it")
    return hull.points, hull.faces


@lru_cache(maxsize=64)
def surface_points(shape: Shape, n: int) -> FloatArray:
    """Points (n, 3), m, spread evenly by area over a shape's surface; always the same."""
    vertices, faces = surface_triangles(shape)
    corners = vertices[faces]
    sides = corners[:, 1:] - corners[:, :1]
    areas = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    rng = np.random.default_rng(0)
    ends = np.cumsum(areas)
    # one in each of n equal shares of the area
    chosen = np.searchsorted(ends, (np.arange(n) + rng.random(n)) / n * ends[-1], side="right")
    chosen = np.minimum(chosen, len(faces) - 1)
    u, v = np.sqrt(rng.random(n)), rng.random(n)
    weights = np.column_stack([1.0 - u, u * (1.0 - v), u * v])
    points: FloatArray = np.einsum("nk,nkd->nd", weights, corners[chosen])
    return points
