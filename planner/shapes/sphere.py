"""Sphere."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import casadi as ca
import coal
import numpy as np

from planner.shapes.base import Shape, Sized, checked_points, unit
from planner.shapes.surface import Surface, WholeSurface, soft_norm
from planner.spatial import FloatArray


@dataclass(frozen=True)
class Sphere(Sized, Shape):
    """A ball.

    Attributes:
        radius: m.
    """

    kind: ClassVar[str] = "sphere"
    size_names: ClassVar[tuple[str, ...]] = ("radius",)
    default_sizes: ClassVar[tuple[float, ...]] = (0.035,)
    ball_like: ClassVar[bool] = True
    radius: float

    @property
    def half_extents(self) -> FloatArray:
        """The radius three times, (3,), m."""
        return np.full(3, self.radius)

    @property
    def bounding_radius(self) -> float:
        """The radius, m."""
        return self.radius

    @property
    def volume(self) -> float:
        """4/3 pi r^3, m3."""
        return 4 / 3 * np.pi * self.radius**3

    def inertia(self, mass: float) -> FloatArray:
        """2/5 m r^2 about every axis, (3, 3), kg m2."""
        return 0.4 * mass * self.radius**2 * np.eye(3)

    def coal_geometry(self) -> Any:
        """``coal.Sphere``."""
        return coal.Sphere(self.radius)

    def mujoco_geom(self) -> tuple[str, tuple[float, ...]]:
        """Type "sphere", size: radius."""
        return "sphere", (self.radius,)

    def closest_point(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See ``Shape``; the centre is sent to +x."""
        normals = unit(checked_points(points))
        return self.radius * normals, normals

    def support(self, direction: FloatArray) -> float:
        """The radius, m."""
        return self.radius

    def curvature_and_edges(
        self, points: FloatArray, normals: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Its radius everywhere, and no edge."""
        return np.full(len(points), self.radius), np.full(len(points), np.inf)

    def surface(self) -> Surface:
        """See ``Shape``."""
        return _SURFACE


class _SphereSurface(WholeSurface):
    kind = "sphere"

    def size(self, shape: Sphere) -> FloatArray:
        return np.array([shape.radius, 0.0, 0.0])

    def outward_normal(self, size: Any, code: Any, p: Any) -> Any:
        return p / size[0]

    def surface_error(self, size: Any, code: Any, p: Any) -> Any:
        return (ca.dot(p, p) - size[0] ** 2) / (2 * size[0])

    def clearance(self, size: Any, c: Any) -> Any:
        return soft_norm(c[0], c[1], c[2]) - size[0]


_SURFACE = _SphereSurface()
