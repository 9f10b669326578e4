"""Signed distance of a mesh at all nodes of a grid at once, for its ``DistanceField``.

Nodes next to the surface are measured exactly. Every other node is measured to the triangle of the
nearest of those (exact Euclidean distance transform). Its sign is that of its connected region,
which the winding number at one node gives: two neighbouring nodes that are both more than half a
spacing from the surface are on the same side of it.
"""

from __future__ import annotations

import numpy as np

from planner.shapes.base import Shape
from planner.shapes.field.distance_field import DistanceField
from planner.shapes.field.fit import fit_field, grid_nodes
from planner.shapes.meshes.nearest_triangle import NearestTriangles
from planner.shapes.meshes.triangles import COVERED, cover, nearest_on_triangles, winding_number
from planner.spatial import FloatArray, IntArray

__all__ = ["FIELD_VERSION", "field_fits", "fit_mesh_field"]

FIELD_VERSION = "v5"
"""Part of the key of fields on disk: to be changed whenever a fitted field would change."""

APART = 0.55
"""Distance from the surface, in spacings, beyond which a node's sign is that of its region: a
crossing between two nodes is within 0.5 of one of them."""

STEP = (1.0 - APART) / COVERED
"""Spacing of the points on the surface, in spacings of the grid, so that every node within
``APART`` is a corner of a cell with such a point."""

HALF_DIAGONAL = 0.5 * 3**0.5
"""Half a cell's diagonal, in spacings."""

FAR_POINTS = 4_000
"""Points on the surface, about, of which the nearest chooses the triangle that a far node is
measured to: some 4 mm apart, which leaves 0.1 mm at 25 mm."""


def fit_mesh_field(surface: NearestTriangles, thickness: float) -> DistanceField:
    """The field of a sound mesh whose centre of mass is at the origin.

    Args:
        surface: Its triangles.
        thickness: Of its walls, m, if it has thin ones: ``Mesh.wall_thickness``.
    """
    distance = _MeshDistance(surface)
    corners = surface.corners.reshape(-1, 3)
    return fit_field(
        distance.far_away,
        corners.min(axis=0),
        corners.max(axis=0),
        on_grid=distance.on_grid,
        bracket=distance.bracket,
        smoothing=min(SMOOTHED_SHARE * thickness, SMOOTHED_MOST),
        wall=thickness,
    )


SMOOTHED_SHARE = 0.2
"""Standard deviation of the smoothing over twice the volume by the area, which is the thickness of
a thin wall: walls, handles and shafts keep their place."""

SMOOTHED_MOST = 0.004
"""Largest standard deviation of the smoothing, m. Smoothing rounds edges, which keeps contacts off
them, and evens out the roughness of scans."""


class _MeshDistance:
    """Distances on the finest grid, and from there outwards."""

    def __init__(self, surface: NearestTriangles) -> None:
        from scipy.spatial import cKDTree  # here, since SciPy loads slowly

        self.surface = surface
        step = float(np.sqrt(surface.areas.sum() / FAR_POINTS))
        points, owner = cover(surface.corners, step)
        # one point of each cube is enough where triangles are smaller than a step
        _, one = np.unique(np.floor(points / step), axis=0, return_index=True)
        self.far_owner, self.far_tree = owner[one], cKDTree(points[one])

    def on_grid(self, first: IntArray, shape: tuple[int, int, int], h: float) -> FloatArray:
        """Signed distance (nx, ny, nz), m; kept for ``far_away`` and ``bracket``.

        Where many triangles are near a node, it may be up to a spacing too large in size.
        """
        from scipy.ndimage import distance_transform_edt  # here, since SciPy loads slowly
        from scipy.spatial import cKDTree  # here, since SciPy loads slowly

        corners = self.surface.corners
        points, owner = cover(corners, STEP * h)
        cells = np.floor(points / h).astype(np.int64) - first
        band = np.zeros(shape, dtype=bool)
        for corner in np.ndindex(2, 2, 2):
            band[tuple((cells + corner).T)] = True
        nodes = grid_nodes(first, shape, h).reshape(*shape, 3)
        in_band = nodes[band]
        _, guess = cKDTree(points).query(in_band)
        nearest, triangle, normals = self.surface.nearest_around(in_band, owner[guess])
        gap = in_band - nearest
        signed = np.linalg.norm(gap, axis=1) * np.where(
            np.einsum("nd,nd->n", gap, normals) < 0, -1.0, 1.0
        )
        of_node = np.zeros(shape, dtype=np.int64)
        of_node[band] = triangle
        self.cells_to_band, source = distance_transform_edt(~band, return_indices=True)
        beyond = ~band
        away = nodes[beyond]
        onto, _ = nearest_on_triangles(away, corners[of_node[tuple(source[:, beyond])]])
        out = np.empty(shape)
        out[band], out[beyond] = signed, np.linalg.norm(away - onto, axis=1)
        self.first, self.h, self.samples = first, h, self._with_signs(out, nodes, APART * h)
        return self.samples

    def _with_signs(self, distance: FloatArray, nodes: FloatArray, apart: float) -> FloatArray:
        """Give every node away from the surface the sign of its region."""
        from scipy.ndimage import label, maximum_position  # here, since SciPy loads slowly

        region, count = label(np.abs(distance) > apart)
        farthest = maximum_position(np.abs(distance), region, np.arange(1, count + 1))
        places = nodes[tuple(np.array(farthest).T)]
        inside = winding_number(places, self.surface.corners) > 0.5
        signs = np.where(np.concatenate([[False], inside]), -1.0, 1.0)
        out: FloatArray = np.where(region > 0, signs[region] * np.abs(distance), distance)
        return out

    def bracket(self, nodes: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Bounds (n,), m, of the signed distance of nodes (n, 3) of the finest grid.

        Samples are distances of points of the surface, and have the right sign. Around every point
        of the surface, the nearest corner of a cell is next to it: half a spacing off at most along
        each axis, and no nearer to a node than the nearest of those that were measured.
        """
        index = tuple((np.rint(nodes / self.h).astype(np.int64) - self.first).T)
        sample = self.samples[index]
        most = np.abs(sample)
        least = self.h * np.maximum(self.cells_to_band[index] - HALF_DIAGONAL, 0.0)
        inside = sample < 0
        return np.where(inside, -most, least), np.where(inside, -least, most)

    def far_away(self, points: FloatArray) -> FloatArray:
        """Signed distance (n,), m; interpolated linearly where the finest grid is."""
        from scipy.ndimage import map_coordinates  # here, since SciPy loads slowly

        inside = map_coordinates(
            self.samples, (points / self.h - self.first).T, order=1, mode="constant", cval=np.nan
        )
        beyond = np.isnan(inside)
        away = points[beyond]
        _, near = self.far_tree.query(away)
        onto, _ = nearest_on_triangles(away, self.surface.corners[self.far_owner[near]])
        inside[beyond] = np.linalg.norm(away - onto, axis=1)
        out: FloatArray = inside
        return out


FIT = 1e-6
"""Distance (m) by which a kept field may be worse than the error that it states."""

CHECKED = 256
"""Vertices of a mesh, about, at which a kept field is checked, and points in its bounding box."""


def field_fits(mesh: Shape, corners: FloatArray, field: DistanceField) -> bool:
    """Whether a field is within its own error of a mesh's distance, at points in its box.

    Args:
        mesh: The mesh.
        corners: Its vertices (n, 3), m.
        field: What was kept for it.
    """
    numbers = [field.far_radius, field.error, *(level.spacing for level in field.levels)]
    if not np.isfinite(numbers).all() or min(numbers) <= 0 or field.error > mesh.bounding_radius:
        return False
    if not all(np.isfinite(level.coefficients).all() for level in field.levels):
        return False
    lower, upper = corners.min(axis=0), corners.max(axis=0)
    inside = np.random.default_rng(0).uniform(lower, upper, (CHECKED, 3))
    points = np.concatenate([corners[:: max(1, len(corners) // CHECKED)], inside])
    off = np.abs(field.value(points) - mesh.signed_distance(points))
    return bool(off.max() <= field.error + FIT)
