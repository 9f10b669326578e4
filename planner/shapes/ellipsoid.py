"""Ellipsoid.

The nearest surface point to p is x_i = a_i^2 p_i / (a_i^2 + t), where t is the largest root of
sum_i (a_i p_i / (a_i^2 + t))^2 = 1 (Eberly, "Distance from a point to an ellipse, an ellipsoid, or
a hyperellipsoid"). With c the shortest semi-axis, u = 1 + t/c^2 >= 0, g_i = (a_i/c)^2 - 1 and
w_i = a_i |p_i| / c^2 this is S(u) = sum_i (w_i / (u + g_i))^2 = 1, which does not cancel where a
point deep inside makes u small. S(u)^(-1/2) is concave and increasing, so that Newton's method on
S^(-1/2) - 1 from a u with S(u) >= 1 climbs to the root without overshooting (the secular equation
of trust-region methods: Conn, Gould and Toint, "Trust-region methods", section 7.3).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import casadi as ca
import coal
import numpy as np

from planner.shapes.base import Boxed, Surface, WholeSurface, checked_points, sign, soft_norm, unit
from planner.spatial import FloatArray

ITERATIONS = 60
"""Cap on Newton steps. Five to ten are usual; points next to the focal curve, at distances from a
symmetry plane down to ``ON_PLANE``, need up to 40."""

ROOT_TOL = 1e-15
"""Relative step in u at which Newton's method stops: a few units in the last place."""

ON_PLANE = 1e-18
"""Coordinates below this fraction of the shortest semi-axis count as zero: far below rounding."""


@dataclass(frozen=True)
class Ellipsoid(Boxed):
    """An ellipsoid. It rests with its shortest axis upright, its longest along world x.

    Attributes:
        size: Full axis lengths x, y, z (twice the semi-axes), m.
    """

    kind: ClassVar[str] = "ellipsoid"
    default_sizes: ClassVar[tuple[float, ...]] = (0.09, 0.07, 0.06)
    ball_like: ClassVar[bool] = True
    size: tuple[float, float, float]

    @property
    def bounding_radius(self) -> float:
        """The longest semi-axis, m."""
        return max(self.size) / 2

    @property
    def volume(self) -> float:
        """4/3 pi a b c, m3."""
        return float(4 / 3 * np.pi * np.prod(self.half_extents))

    def inertia(self, mass: float) -> FloatArray:
        """Diagonal m/5 (b^2 + c^2), m/5 (c^2 + a^2), m/5 (a^2 + b^2); (3, 3), kg m2."""
        squares = self.half_extents**2
        return np.diag(mass / 5 * (squares.sum() - squares))

    def coal_geometry(self) -> Any:
        """``coal.Ellipsoid``, which takes semi-axes."""
        return coal.Ellipsoid(*(v / 2 for v in self.size))

    def mujoco_geom(self) -> tuple[str, tuple[float, ...]]:
        """Type "ellipsoid", size: semi-axes."""
        x, y, z = self.size
        return "ellipsoid", (x / 2, y / 2, z / 2)

    def closest_point(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See ``Shape`` and the module; of two points equally near, the one on the + side."""
        p, a = checked_points(points), self.half_extents
        on_ball = sign(p) * _on_unit_ball(np.abs(p), a)
        return a * on_ball, unit(on_ball * (a.min() / a))

    def support(self, direction: FloatArray) -> float:
        """Length of (a d_x, b d_y, c d_z), m."""
        return float(np.linalg.norm(self.half_extents * direction))

    @property
    def resting_rotation(self) -> FloatArray:
        """Its shortest axis upright, its longest along the world's x."""
        order = np.argsort(self.size, kind="stable")
        shortest, longest = order[0], order[2]
        rotation = np.zeros((3, 3))
        rotation[2, shortest] = rotation[0, longest] = 1.0
        rotation[1] = np.cross(rotation[2], rotation[0])
        return rotation

    def curvature_and_edges(
        self, points: FloatArray, normals: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """c^2 / a for its shortest and longest half axes everywhere, and no edge."""
        least = self.half_extents.min() ** 2 / self.half_extents.max()
        return np.full(len(points), least), np.full(len(points), np.inf)

    def surface(self) -> Surface:
        """See ``Shape``."""
        return _SURFACE


def _on_unit_ball(p: FloatArray, a: FloatArray) -> FloatArray:
    """Nearest surface points divided by the semi-axes, (n, 3), for points in the first octant.

    Args:
        p: Points (n, 3), all coordinates >= 0, m.
        a: Semi-axes (3,), m.
    """
    c = a.min()
    w = np.where(p < ON_PLANE * c, 0.0, p / c * (a / c))
    g = (a / c - 1) * (a / c + 1)
    u = np.maximum((w - g).max(axis=1), 0.0)
    for _ in range(ITERATIONS):
        y, slope = _ratio(w, u[:, None] + g), _ratio(1.0, u[:, None] + g)
        squares = (y**2).sum(axis=1)
        step = _ratio(squares * (np.sqrt(squares) - 1), (y**2 * slope).sum(axis=1))
        # S(0) < 1 happens on the symmetry plane across a shortest axis: the root there is u = 0
        before, u = u, np.maximum(u + step, 0.0)
        if (np.abs(u - before) <= ROOT_TOL * u).all():
            break
    y = _ratio(w, u[:, None] + g)
    # what is missing to length 1 is then the coordinate along that axis
    shortest = int(np.argmin(a))
    missing = np.maximum(1.0 - (y**2).sum(axis=1), 0.0)
    y[:, shortest] = np.where(u == 0, np.sqrt(missing), y[:, shortest])
    lengths: FloatArray = np.linalg.norm(y, axis=1, keepdims=True)
    return y / lengths


def _ratio(above: FloatArray | float, below: FloatArray) -> FloatArray:
    """Division with 0 where the denominator is 0."""
    safe = np.where(below > 0, below, 1.0)
    return np.where(below > 0, above / safe, 0.0)


class _EllipsoidSurface(WholeSurface):
    kind = "ellipsoid"

    def size(self, shape: Ellipsoid) -> FloatArray:
        return np.array(shape.half_extents)

    def outward_normal(self, size: Any, code: Any, p: Any) -> Any:
        gradient = p / size**2
        return gradient / soft_norm(gradient[0], gradient[1], gradient[2])

    def surface_error(self, size: Any, code: Any, p: Any) -> Any:
        gradient = p / size**2
        return (ca.dot(p, gradient) - 1) / (2 * soft_norm(gradient[0], gradient[1], gradient[2]))

    def clearance(self, size: Any, c: Any) -> Any:
        a, b = c / size, c / size**2
        k0, k1 = soft_norm(a[0], a[1], a[2]), soft_norm(b[0], b[1], b[2])
        return k0 * (k0 - 1) / k1


_SURFACE = _EllipsoidSurface()
