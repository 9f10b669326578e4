"""Cylinder."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar

import casadi as ca
import coal
import numpy as np

from planner.shapes.base import ALIGNED, Shape, Sized, checked_points, nearest_on_cylinder
from planner.shapes.surface import KEPT, Patch, Surface, edge_margin, soft_max, soft_norm
from planner.spatial import FloatArray


@dataclass(frozen=True)
class Cylinder(Sized, Shape):
    """A cylinder about z. It rests standing.

    Attributes:
        radius: m.
        height: Full height, m.
    """

    kind: ClassVar[str] = "cylinder"
    size_names: ClassVar[tuple[str, ...]] = ("radius", "height")
    default_sizes: ClassVar[tuple[float, ...]] = (0.03, 0.1)
    turns_tips: ClassVar[bool] = False
    radius: float
    height: float

    @property
    def half_extents(self) -> FloatArray:
        """Radius, radius, half height, (3,), m."""
        return np.array([self.radius, self.radius, self.height / 2])

    @property
    def bounding_radius(self) -> float:
        """From the centre to a rim, m."""
        return float(np.hypot(self.radius, self.height / 2))

    @property
    def volume(self) -> float:
        """Pi r^2 h, m3."""
        return np.pi * self.radius**2 * self.height

    def inertia(self, mass: float) -> FloatArray:
        """Diagonal: m (3 r^2 + h^2)/12 across (twice), m r^2/2 along z; (3, 3), kg m2."""
        across = mass * (3 * self.radius**2 + self.height**2) / 12
        return np.diag([across, across, mass * self.radius**2 / 2])

    def coal_geometry(self) -> Any:
        """``coal.Cylinder``, which takes the full height."""
        return coal.Cylinder(self.radius, self.height)

    def mujoco_geom(self) -> tuple[str, tuple[float, ...]]:
        """Type "cylinder", size: radius, half height."""
        return "cylinder", (self.radius, self.height / 2)

    def closest_point(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See ``Shape``; inside, the nearer of side and end."""
        return nearest_on_cylinder(checked_points(points), self.radius, self.height / 2)

    def support(self, direction: FloatArray) -> float:
        """Radius |direction_xy| + height/2 |direction_z|, m."""
        across = np.hypot(direction[0], direction[1])
        return float(self.radius * across + self.height / 2 * abs(direction[2]))

    def curvature_and_edges(
        self, points: FloatArray, normals: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Flat on an end, its radius on the side; the edges are the rims."""
        curvature, gap = super().curvature_and_edges(points, normals)
        end = np.abs(normals[:, 2]) > 1.0 - ALIGNED
        side = np.abs(normals[:, 2]) < ALIGNED
        curvature[end], curvature[side] = np.inf, self.radius
        gap[end] = self.radius - np.linalg.norm(points[end, :2], axis=1)
        gap[side] = 0.5 * self.height - np.abs(points[side, 2])
        return curvature, gap

    def surface(self) -> Surface:
        """See ``Shape``."""
        return _SURFACE


class _CylinderSurface(Surface):
    """Code: [1 on the side, 0 on an end; sign of the end; unused]."""

    kind = "cylinder"

    def size(self, shape: Cylinder) -> FloatArray:
        return np.array([shape.radius, shape.height / 2, 0.0])

    def patches(self, shape: Cylinder) -> tuple[Patch, ...]:
        return _patches(shape)

    def patch_at(self, shape: Cylinder, point: FloatArray, normal: FloatArray) -> Patch:
        side, top, bottom = self.patches(shape)
        if np.hypot(normal[0], normal[1]) >= abs(normal[2]):
            return side
        return top if normal[2] > 0 else bottom

    def outward_normal(self, size: Any, code: Any, p: Any) -> Any:
        on_side = code[0]
        return ca.vertcat(on_side * p[0] / size[0], on_side * p[1] / size[0], code[1])

    def surface_error(self, size: Any, code: Any, p: Any) -> Any:
        radial = (p[0] ** 2 + p[1] ** 2 - size[0] ** 2) / (2 * size[0])
        return code[0] * radial + (1 - code[0]) * (p[2] - code[1] * size[1])

    def clearance(self, size: Any, c: Any) -> Any:
        return soft_max(soft_norm(c[0], c[1]) - size[0], soft_norm(c[2]) - size[1])


@lru_cache(maxsize=KEPT)
def _patches(shape: Cylinder) -> tuple[Patch, ...]:
    radius, half = shape.radius, shape.height / 2
    side = np.array([2 * radius, 2 * radius, half - edge_margin(half)])
    out = [Patch(name="side", code=np.array([1.0, 0.0, 0.0]), lower=-side, upper=side)]
    # the largest square inside the end's disc less its margin
    square = (radius - edge_margin(radius)) / np.sqrt(2)
    for sign in (1.0, -1.0):
        out.append(
            Patch(
                name="+z" if sign > 0 else "-z",
                code=np.array([0.0, sign, 0.0]),
                # z is fixed by the surface equation; its bounds only leave room around it
                lower=np.array([-square, -square, sign * half - radius]),
                upper=np.array([square, square, sign * half + radius]),
            )
        )
    return tuple(out)


_SURFACE = _CylinderSurface()
