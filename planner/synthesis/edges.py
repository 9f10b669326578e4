"""Edges of a mesh: contacts keep off them.

The programme sees rounded edges, and rounded edges are good places to hold on to. On the true one a
pad that creeps by a millimetre meets another normal, so the verdict refuses such contacts. Here is
what counts as an edge, and the nearest place that is none.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.spatial import cKDTree

from planner.shapes import Mesh
from planner.spatial import FloatArray

__all__ = ["EDGE_RADIUS", "EDGE_SPREAD", "ROOM", "EdgeFree", "edge_free", "spreads"]

EDGE_RADIUS = 0.002
"""How far (m) around a contact normals are looked at: what a pad creeps and rolls in a grasp."""

EDGE_SPREAD = float(np.deg2rad(25.0))
"""Largest dispersion of normals there (rad); it is 45 degrees on a right-angled edge."""

ROOM = 0.001
"""Half the side (m) of the box in which a contact may move that was brought off an edge."""

SAMPLES = 3000
"""Surface points among which one off the edges is looked for: some 3 mm apart on a mug."""

LOOKED_AT = 60
"""Nearest samples that are looked at for one contact."""


def spreads(mesh: Mesh, points: FloatArray) -> FloatArray:
    """Dispersion (n,) of normals around surface points (n, 3), rad."""
    return np.array([mesh.normal_dispersion(point, EDGE_RADIUS) for point in points])


class EdgeFree:
    """Surface points of a mesh with no edge nearby, where the smooth field has the true normals.

    Each is looked at when it is first needed.
    """

    def __init__(self, mesh: Mesh) -> None:
        """Spread the samples."""
        self._mesh = mesh
        points, normals = mesh.surface_samples(SAMPLES, np.random.default_rng(0))
        slopes = mesh.field().taylor(points, 1)[:, 1:4]
        slopes /= np.maximum(np.linalg.norm(slopes, axis=1, keepdims=True), 1e-9)
        faithful = np.einsum("ij,ij->i", slopes, normals) > FAITHFUL
        self._points, self._normals = points[faithful], normals[faithful]
        self._tree = cKDTree(self._points) if faithful.any() else None
        self._known: dict[int, bool] = {}

    def nearest(self, point: FloatArray, normal: FloatArray) -> FloatArray | None:
        """The nearest sample (3,) with a similar normal and ``ROOM`` to all sides; None if far."""
        if self._tree is None:
            return None
        _, numbers = self._tree.query(point, k=min(LOOKED_AT, len(self._points)))
        for number in map(int, np.atleast_1d(numbers)):
            if self._normals[number] @ normal > SAME_SIDE and self._is_free(number):
                found: FloatArray = self._points[number]
                return found
        return None

    def _is_free(self, number: int) -> bool:
        if number not in self._known:
            around = EDGE_RADIUS + ROOM
            spread = self._mesh.normal_dispersion(self._points[number], around)
            self._known[number] = spread < EDGE_SPREAD
        return self._known[number]


FAITHFUL = float(np.cos(np.deg2rad(8.0)))
"""Least cosine between the smooth field's normal and the triangle's."""

SAME_SIDE = 0.5
"""Least cosine between the normals of a contact and of the place it is brought to."""


@lru_cache(maxsize=16)
def edge_free(mesh: Mesh) -> EdgeFree:
    """The edge-free points of a mesh, kept."""
    return EdgeFree(mesh)
