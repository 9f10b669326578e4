"""The smooth surface of a mesh in the synthesis problem, and the surface of any shape."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from planner.shapes import Mesh, Shape
from planner.shapes.surface import Patch, Surface, soft_norm, whole_surface
from planner.spatial import FloatArray
from planner.synthesis.field_points import Field, FieldPoints

__all__ = ["mesh_surface", "surface_of"]

NORMAL_ERROR, DISTANCE_ERROR = 0.1, 0.0007
"""Largest errors of the smooth distance: of its normals (rad) near edges, and of its values (m) on
the surface."""

STEEP = 0.93
"""Least slope (-) of the smooth distance at a contact that is on no edge. The slope is the length
of the mean normal within the radius of smoothing: 1 on flat and evenly round places, 0.75 on a
right-angled edge."""


class _MeshSurface(Surface):
    """The zero level of a mesh's smooth distance field; one object per problem."""

    kind = "mesh"

    def __init__(
        self,
        normal_error: float,
        distance_error: float,
        steep: float,
        steep_on_walls: float,
        edge_worth: float,
    ) -> None:
        """Begin to collect the points at which the problem needs the field."""
        self.field: FieldPoints = FieldPoints()
        self.normal_error, self.distance_error = normal_error, distance_error
        self._steep, self._steep_on_walls = steep, steep_on_walls
        self._edge_worth = edge_worth

    def field_of(self, shape: Mesh) -> Field:
        return shape.field()

    def size(self, shape: Mesh) -> FloatArray:
        steep = self._steep_on_walls if shape.wall_thickness < WALL else self._steep
        return np.array([_steepness(shape, steep), 0.0, 0.0])

    def patches(self, shape: Mesh) -> tuple[Patch, ...]:
        return (whole_surface("surface", 2 * shape.half_extents),)

    def patch_at(self, shape: Mesh, point: FloatArray, normal: FloatArray) -> Patch:
        return self.patches(shape)[0]

    def outward_normal(self, size: Any, code: Any, p: Any) -> Any:
        gradient = self.field.at(p)[1]
        return gradient / soft_norm(gradient[0], gradient[1], gradient[2])

    def surface_error(self, size: Any, code: Any, p: Any) -> Any:
        return self.field.at(p)[0]

    def flatness(self, size: Any, p: Any) -> Any:
        gradient = self.field.at(p)[1]
        return self._edge_worth * (ca.sumsqr(gradient) - size[0] ** 2) / (2 * size[0])

    def clearance(self, size: Any, c: Any) -> Any:
        return self.field.at(c)[0]


WALL = 0.006
"""Thickness (m) below which a mesh has thin walls, or is a small solid: a cube of 18 mm."""

SAMPLES = 1000
"""Surface points for the median slope, which thin walls lower everywhere."""


@lru_cache(maxsize=16)
def _steepness(mesh: Mesh, steep: float) -> float:
    """Least slope (-) of the smooth distance at points of a mesh that are on no edge."""
    points, _ = mesh.surface_samples(SAMPLES, np.random.default_rng(0))
    slopes = np.linalg.norm(mesh.field().taylor(points, 1)[:, 1:4], axis=1)
    return min(steep, float(np.median(slopes)))


def mesh_surface(
    *,
    normal_error: float = NORMAL_ERROR,
    distance_error: float = DISTANCE_ERROR,
    steep: float = STEEP,
    steep_on_walls: float | None = None,
    edge_worth: float = 1.0,
) -> Surface:
    """The form of a mesh in the grasp problem.

    Args:
        normal_error: Largest error of the normals, rad.
        distance_error: Added to every clearance of links, m.
        steep: Least slope (-) of the smooth distance at a contact that is on no edge.
        steep_on_walls: The same on an object of thin walls, where the slope varies; ``steep`` if
            None.
        edge_worth: Weight factor (-) of a lower slope.
    """
    on_walls = steep if steep_on_walls is None else steep_on_walls
    return _MeshSurface(normal_error, distance_error, steep, on_walls, edge_worth)


def surface_of(shape: Shape) -> Surface:
    """The form of a shape in the grasp problem.

    Raises:
        ObjectError: Synthesis does not know this kind of shape.
    """
    if isinstance(shape, Mesh):
        return mesh_surface()
    return shape.surface()
