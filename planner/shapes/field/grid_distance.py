"""The ``DistanceField`` of a mesh: its distance on nested grids, and bounds of it.

Nodes next to the surface are measured (``planner.shapes.meshes.surface_walk``), the others are
interpolated from coarser grids (``planner.shapes.field.pyramid``).
"""

from __future__ import annotations

import numpy as np

from planner.shapes.base import Shape
from planner.shapes.field.distance_field import DistanceField
from planner.shapes.field.fit import finest_spacing, fit_field
from planner.shapes.field.pyramid import Pyramid, within_cells
from planner.shapes.meshes.nearest_triangle import NearestTriangles
from planner.shapes.meshes.surface_walk import SurfaceWalk
from planner.spatial import FloatArray, IntArray

FIELD_VERSION = "v6"
"""Part of the key of fields on disk: to be changed whenever a fitted field would change."""

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
