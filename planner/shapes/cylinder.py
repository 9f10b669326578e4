"""Cylinder."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import coal
import numpy as np

from planner.shapes.base import Shape, checked_length, checked_points
from planner.shapes.nearest import nearest_on_cylinder
from planner.spatial import FloatArray

__all__ = ["Cylinder"]


@dataclass(frozen=True)
class Cylinder(Shape):
    """A cylinder about z. It rests standing.

    Attributes:
        radius: m.
        height: Full height, m.
    """

    kind: ClassVar[str] = "cylinder"
    size_names: ClassVar[tuple[str, ...]] = ("radius", "height")
    radius: float
    height: float

    def __post_init__(self) -> None:
        """Check the sizes."""
        for name in self.size_names:
            value = checked_length(self.kind, name, getattr(self, name))
            object.__setattr__(self, name, value)

    @property
    def sizes(self) -> tuple[float, ...]:
        """Radius and full height, m."""
        return self.radius, self.height

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
