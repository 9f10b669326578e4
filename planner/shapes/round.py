"""Round shapes that their sizes determine: sphere, cylinder, capsule and ellipsoid.

Of an ellipsoid the nearest surface point to p is x_i = a_i^2 p_i / (a_i^2 + t), where t is the
largest root of sum_i (a_i p_i / (a_i^2 + t))^2 = 1 (Eberly, "Distance from a point to an ellipse,
an ellipsoid, or a hyperellipsoid"). With c the shortest semi-axis, u = 1 + t/c^2 >= 0, g_i =
(a_i/c)^2 - 1 and w_i = a_i |p_i| / c^2 this is S(u) = sum_i (w_i / (u + g_i))^2 = 1, which does not
cancel where a point deep inside makes u small. S(u)^(-1/2) is concave and increasing, so that
Newton's method on S^(-1/2) - 1 from a u with S(u) >= 1 climbs to the root without overshooting (the
secular equation of trust-region methods: Conn, Gould and Toint, "Trust-region methods", section
7.3).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar

import casadi as ca
import coal
import numpy as np

from planner.errors import ObjectError
from planner.shapes.base import (
    ALIGNED,
    KEPT,
    Boxed,
    Patch,
    Shape,
    Sized,
    Surface,
    WholeSurface,
    checked_points,
    edge_margin,
    nearest_on_cylinder,
    sign,
    soft_max,
    soft_norm,
    unit,
)
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
        return _SPHERE


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


_SPHERE = _SphereSurface()


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
        return _CYLINDER


class _CylinderSurface(Surface):
    """Code: [1 on the side, 0 on an end; sign of the end; unused]."""

    kind = "cylinder"

    def size(self, shape: Cylinder) -> FloatArray:
        return np.array([shape.radius, shape.height / 2, 0.0])

    def patches(self, shape: Cylinder) -> tuple[Patch, ...]:
        return _cylinder_patches(shape)

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
def _cylinder_patches(shape: Cylinder) -> tuple[Patch, ...]:
    radius, half = shape.radius, shape.height / 2
    side = np.array([2 * radius, 2 * radius, half - edge_margin(half)])
    out = [Patch(name="side", code=np.array([1.0, 0.0, 0.0]), lower=-side, upper=side)]
    # the largest square inside the end's disc less its margin
    square = (radius - edge_margin(radius)) / np.sqrt(2)
    for end in (1.0, -1.0):
        out.append(
            Patch(
                name="+z" if end > 0 else "-z",
                code=np.array([0.0, end, 0.0]),
                # z is fixed by the surface equation; its bounds only leave room around it
                lower=np.array([-square, -square, end * half - radius]),
                upper=np.array([square, square, end * half + radius]),
            )
        )
    return tuple(out)


_CYLINDER = _CylinderSurface()


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
        return _CAPSULE


class _CapsuleSurface(Surface):
    """Code: [1 on the side, 0 on an end cap; sign of the cap; unused]."""

    kind = "capsule"

    def size(self, shape: Capsule) -> FloatArray:
        return np.array([shape.radius, shape.height / 2 - shape.radius, 0.0])

    def patches(self, shape: Capsule) -> tuple[Patch, ...]:
        return _capsule_patches(shape)

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
def _capsule_patches(shape: Capsule) -> tuple[Patch, ...]:
    radius, core = shape.radius, shape.height / 2 - shape.radius
    wide = 2 * radius
    side = np.array([wide, wide, core])
    out = [Patch(name="side", code=np.array([1.0, 0.0, 0.0]), lower=-side, upper=side)]
    for end in (1.0, -1.0):
        ends = sorted((end * core, end * (core + wide)))
        out.append(
            Patch(
                name="+z" if end > 0 else "-z",
                code=np.array([0.0, end, 0.0]),
                lower=np.array([-wide, -wide, ends[0]]),
                upper=np.array([wide, wide, ends[1]]),
            )
        )
    return tuple(out)


_CAPSULE = _CapsuleSurface()


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
        return _ELLIPSOID


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


_ELLIPSOID = _EllipsoidSurface()
