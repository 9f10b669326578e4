"""Capsule."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar

import casadi as ca
import coal
import numpy as np

from planner.errors import ObjectError
from planner.shapes.base import Shape, Sized, checked_points, unit
from planner.shapes.surface import KEPT, Patch, Surface, soft_norm
from planner.spatial import FloatArray


@dataclass(frozen=True)
class Capsule(Sized, Shape):
    """A capsule about z: all points within ``radius`` of a segment. It rests lying along world x.

    Attributes:
        radius: m.
        height: Full height, end to end with both caps, m; more than twice the radius.
    """

    kind: ClassVar[str] = "capsule"
    size_names: ClassVar[tuple[str, ...]] = ("radius", "height")
    default_sizes: ClassVar[tuple[float, ...]] = (0.03, 0.12)
    turns_tips: ClassVar[bool] = False
    radius: float
    height: float

    def _check(self) -> None:
        if self.height <= 2 * self.radius:
            raise ObjectError(
                f"capsule: height {self.height} m includes both caps and must be more than twice "
                f"the radius {self.radius} m; give a larger height, or use a sphere"
            )

    @property
    def core(self) -> float:
        """Distance between the centres of the caps, m."""
        return self.height - 2 * self.radius

    @property
    def half_extents(self) -> FloatArray:
        """Radius, radius, half the full height, (3,), m."""
        return np.array([self.radius, self.radius, self.height / 2])

    @property
    def bounding_radius(self) -> float:
        """Half the full height, m."""
        return self.height / 2

    @property
    def volume(self) -> float:
        """Tube and two half balls, m3."""
        return np.pi * self.radius**2 * (self.core + 4 / 3 * self.radius)

    def inertia(self, mass: float) -> FloatArray:
        """Tube and two half balls, (3, 3), kg m2.

        The centre of mass of a half ball is 3/8 r from its flat side, so moving its inertia
        2/5 m r^2 from its flat side's centre to the capsule's adds m (d^2 + 3/4 d r), d = core/2.
        """
        r, h = self.radius, self.core
        tube = mass * h / (h + 4 / 3 * r)
        caps = mass - tube
        along = tube * r**2 / 2 + caps * 0.4 * r**2
        across = tube * (3 * r**2 + h**2) / 12 + caps * (0.4 * r**2 + h**2 / 4 + 3 / 8 * h * r)
        return np.diag([across, across, along])

    def coal_geometry(self) -> Any:
        """``coal.Capsule``, which takes the distance between the centres of the caps."""
        return coal.Capsule(self.radius, self.core)

    def mujoco_geom(self) -> tuple[str, tuple[float, ...]]:
        """Type "capsule", size: radius, half the distance between the centres of the caps."""
        return "capsule", (self.radius, self.core / 2)

    def closest_point(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See ``Shape``; points on the axis between the caps are sent to +x."""
        p = checked_points(points)
        on_axis = np.zeros_like(p)
        on_axis[:, 2] = np.clip(p[:, 2], -self.core / 2, self.core / 2)
        normals = unit(p - on_axis)
        return on_axis + self.radius * normals, normals

    def support(self, direction: FloatArray) -> float:
        """Radius + core/2 |direction_z|, m."""
        return float(self.radius + self.core / 2 * abs(direction[2]))

    @property
    def resting_rotation(self) -> FloatArray:
        """Lying, its axis along the world's x."""
        return np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])

    def curvature_and_edges(
        self, points: FloatArray, normals: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Its radius everywhere, and no edge."""
        return np.full(len(points), self.radius), np.full(len(points), np.inf)

    def surface(self) -> Surface:
        """See ``Shape``."""
        return _SURFACE


class _CapsuleSurface(Surface):
    """Code: [1 on the side, 0 on an end cap; sign of the cap; unused]."""

    kind = "capsule"

    def size(self, shape: Capsule) -> FloatArray:
        return np.array([shape.radius, shape.height / 2 - shape.radius, 0.0])

    def patches(self, shape: Capsule) -> tuple[Patch, ...]:
        return _patches(shape)

    def patch_at(self, shape: Capsule, point: FloatArray, normal: FloatArray) -> Patch:
        side, top, bottom = self.patches(shape)
        core = shape.height / 2 - shape.radius
        if abs(point[2]) <= core:
            return side
        return top if point[2] > 0 else bottom

    def _arm(self, size: Any, code: Any, p: Any) -> Any:
        """From the nearest point of the core to p."""
        return ca.vertcat(p[0], p[1], (1 - code[0]) * (p[2] - code[1] * size[1]))

    def outward_normal(self, size: Any, code: Any, p: Any) -> Any:
        return self._arm(size, code, p) / size[0]

    def surface_error(self, size: Any, code: Any, p: Any) -> Any:
        arm = self._arm(size, code, p)
        return (ca.dot(arm, arm) - size[0] ** 2) / (2 * size[0])

    def clearance(self, size: Any, c: Any) -> Any:
        beyond = ca.fmax(soft_norm(c[2]) - size[1], 0)
        return soft_norm(c[0], c[1], beyond) - size[0]


@lru_cache(maxsize=KEPT)
def _patches(shape: Capsule) -> tuple[Patch, ...]:
    radius, core = shape.radius, shape.height / 2 - shape.radius
    wide = 2 * radius
    side = np.array([wide, wide, core])
    out = [Patch(name="side", code=np.array([1.0, 0.0, 0.0]), lower=-side, upper=side)]
    for sign in (1.0, -1.0):
        ends = sorted((sign * core, sign * (core + wide)))
        out.append(
            Patch(
                name="+z" if sign > 0 else "-z",
                code=np.array([0.0, sign, 0.0]),
                lower=np.array([-wide, -wide, ends[0]]),
                upper=np.array([wide, wide, ends[1]]),
            )
        )
    return tuple(out)


_SURFACE = _CapsuleSurface()
