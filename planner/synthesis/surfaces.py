"""Object surfaces for the synthesis NLP: smooth patches to touch and a smooth distance to avoid.

A contact point is a decision variable that lies exactly on the true surface. Edges need no
rounding, because the surface is cut along them into smooth patches (the faces of a box; side and
ends of a cylinder), each finger is assigned to one patch, and the point keeps a margin from the
patch's rim. The assignment enters the NLP as numbers (``Patch.code``, bounds of the point), so one
NLP per hand and kind of shape serves every size and every assignment.

``clearance`` is used for links that must stay away. It is exact for spheres and capsules; the
largest of the face distances, softened over ``SOFTNESS``, for boxes and cylinders, which for balls
of 8 mm or more is within 0.08 mm of a lower bound of the true distance (the worst is straight above
a box's corner); first-order accurate for ellipsoids. The verdict is always on the true geometry,
see ``planner.synthesis.verify``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar

import casadi as ca
import numpy as np

from planner.errors import ObjectError
from planner.shapes import Box, Capsule, Cylinder, Ellipsoid, Mesh, Shape, Sphere
from planner.spatial import FloatArray
from planner.synthesis.nlp import Field, FieldPoints

__all__ = [
    "CODE_DIM",
    "SIZE_DIM",
    "Patch",
    "Surface",
    "box_clearance",
    "mesh_surface",
    "surface_of",
]

SOFTNESS = 0.002
"""Length (m) over which the largest of several face distances is softened."""

EDGE_MARGIN = 0.004
"""Distance (m) that a contact keeps from the rim of its patch: a fingertip that rolls or creeps by
a few millimetres must not reach the edge. At most a quarter of the patch's half width."""

SIZE_DIM = 3
"""Numbers that describe a shape's size in the NLP."""

CODE_DIM = 3
"""Numbers that say which patch a finger touches."""


@dataclass(frozen=True, kw_only=True)
class Patch:
    """A smooth part of a surface.

    Attributes:
        name: For people, for example "+x".
        code: (3,), which patch, as numbers for the NLP.
        lower: (3,), lower bounds of a contact point in the object's frame, m.
        upper: (3,), upper bounds.
    """

    name: str
    code: FloatArray
    lower: FloatArray
    upper: FloatArray


class Surface(ABC):
    """How one kind of shape enters the NLP. All expressions are in the object's frame, m."""

    kind: ClassVar[str]
    field: FieldPoints | None = None
    """Where the expressions need a distance field; None for those that are formulas."""
    normal_error: float = 0.0
    """How far (rad) ``outward_normal`` may be from the true one; pads keep that from their rim."""
    distance_error: float = 0.0
    """How far (m) ``clearance`` may be from the true one; links keep that much more away."""

    def anew(self) -> Surface:
        """The same for another programme: it has collected no field points yet."""
        return type(self)()

    def field_of(self, shape: Any) -> Field | None:
        """The distance field of a shape, where ``field`` is not None."""
        return None

    @abstractmethod
    def size(self, shape: Any) -> FloatArray:
        """NLP parameters (3,) of a shape's size, m."""

    @abstractmethod
    def patches(self, shape: Any) -> tuple[Patch, ...]:
        """The patches of a shape."""

    @abstractmethod
    def patch_at(self, shape: Any, point: FloatArray, normal: FloatArray) -> Patch:
        """The patch to which a surface point with this outward normal belongs."""

    @abstractmethod
    def outward_normal(self, size: Any, code: Any, p: Any) -> Any:
        """Outward unit normal (3,) at a point of the patch."""

    @abstractmethod
    def surface_error(self, size: Any, code: Any, p: Any) -> Any:
        """Zero on the patch; m near it. None where the bounds of the patch fix the point."""

    def flatness(self, size: Any, p: Any) -> Any:
        """At least 0 (-) at a contact off edges; None where patches keep contacts off them."""
        return None

    @abstractmethod
    def clearance(self, size: Any, c: Any) -> Any:
        """Smooth signed distance of a point from the surface, m, for avoidance."""


def _soft_norm(*parts: Any) -> Any:
    return ca.sqrt(sum(v * v for v in parts) + 1e-12)


def _soft_max(*values: Any) -> Any:
    top = ca.fmax(values[0], values[1])
    for v in values[2:]:
        top = ca.fmax(top, v)
    # log-sum-exp; shifting by the maximum keeps the exponentials finite and changes nothing
    return top + SOFTNESS * ca.log(sum(ca.exp((v - top) / SOFTNESS) for v in values))


def box_clearance(half: Any, c: Any) -> Any:
    """Smooth distance (m) of a point (3,) from a box of half extents ``half`` at the origin."""
    return _soft_max(*(_soft_norm(c[k]) - half[k] for k in range(3)))


def _margin(half: float) -> float:
    return min(EDGE_MARGIN, half / 4)


def _everywhere(name: str, reach: FloatArray) -> Patch:
    return Patch(name=name, code=np.zeros(CODE_DIM), lower=-reach, upper=reach)


class _SphereSurface(Surface):
    kind = "sphere"

    def size(self, shape: Sphere) -> FloatArray:
        return np.array([shape.radius, 0.0, 0.0])

    def patches(self, shape: Sphere) -> tuple[Patch, ...]:
        return (_everywhere("sphere", 2 * shape.half_extents),)

    def patch_at(self, shape: Sphere, point: FloatArray, normal: FloatArray) -> Patch:
        return self.patches(shape)[0]

    def outward_normal(self, size: Any, code: Any, p: Any) -> Any:
        return p / size[0]

    def surface_error(self, size: Any, code: Any, p: Any) -> Any:
        return (ca.dot(p, p) - size[0] ** 2) / (2 * size[0])

    def clearance(self, size: Any, c: Any) -> Any:
        return _soft_norm(c[0], c[1], c[2]) - size[0]


class _EllipsoidSurface(Surface):
    kind = "ellipsoid"

    def size(self, shape: Ellipsoid) -> FloatArray:
        return np.array(shape.half_extents)

    def patches(self, shape: Ellipsoid) -> tuple[Patch, ...]:
        return (_everywhere("ellipsoid", 2 * shape.half_extents),)

    def patch_at(self, shape: Ellipsoid, point: FloatArray, normal: FloatArray) -> Patch:
        return self.patches(shape)[0]

    def outward_normal(self, size: Any, code: Any, p: Any) -> Any:
        gradient = p / size**2
        return gradient / _soft_norm(gradient[0], gradient[1], gradient[2])

    def surface_error(self, size: Any, code: Any, p: Any) -> Any:
        gradient = p / size**2
        return (ca.dot(p, gradient) - 1) / (2 * _soft_norm(gradient[0], gradient[1], gradient[2]))

    def clearance(self, size: Any, c: Any) -> Any:
        a, b = c / size, c / size**2
        k0, k1 = _soft_norm(a[0], a[1], a[2]), _soft_norm(b[0], b[1], b[2])
        return k0 * (k0 - 1) / k1


class _BoxSurface(Surface):
    kind = "box"

    def size(self, shape: Box) -> FloatArray:
        return np.array(shape.half_extents)

    def patches(self, shape: Box) -> tuple[Patch, ...]:
        half = shape.half_extents
        out = []
        for axis in range(3):
            for sign in (1.0, -1.0):
                code = np.zeros(CODE_DIM)
                code[axis] = sign
                reach = half - np.array([_margin(h) for h in half])
                lower, upper = -reach, reach.copy()
                lower[axis] = upper[axis] = sign * half[axis]
                name = ("+" if sign > 0 else "-") + "xyz"[axis]
                out.append(Patch(name=name, code=code, lower=lower, upper=upper))
        return tuple(out)

    def patch_at(self, shape: Box, point: FloatArray, normal: FloatArray) -> Patch:
        return max(self.patches(shape), key=lambda patch: float(patch.code @ normal))

    def outward_normal(self, size: Any, code: Any, p: Any) -> Any:
        return code

    def surface_error(self, size: Any, code: Any, p: Any) -> Any:
        return None

    def clearance(self, size: Any, c: Any) -> Any:
        return box_clearance(size, c)


class _CylinderSurface(Surface):
    """Code: [1 on the side, 0 on an end; sign of the end; unused]."""

    kind = "cylinder"

    def size(self, shape: Cylinder) -> FloatArray:
        return np.array([shape.radius, shape.height / 2, 0.0])

    def patches(self, shape: Cylinder) -> tuple[Patch, ...]:
        radius, half = shape.radius, shape.height / 2
        side = np.array([2 * radius, 2 * radius, half - _margin(half)])
        out = [Patch(name="side", code=np.array([1.0, 0.0, 0.0]), lower=-side, upper=side)]
        # the largest square inside the end's disc less its margin
        square = (radius - _margin(radius)) / np.sqrt(2)
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
        return _soft_max(_soft_norm(c[0], c[1]) - size[0], _soft_norm(c[2]) - size[1])


class _CapsuleSurface(Surface):
    """Code: [1 on the side, 0 on an end cap; sign of the cap; unused]."""

    kind = "capsule"

    def size(self, shape: Capsule) -> FloatArray:
        return np.array([shape.radius, shape.height / 2 - shape.radius, 0.0])

    def patches(self, shape: Capsule) -> tuple[Patch, ...]:
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
        beyond = ca.fmax(_soft_norm(c[2]) - size[1], 0)
        return _soft_norm(c[0], c[1], beyond) - size[0]


NORMAL_ERROR, DISTANCE_ERROR = 0.1, 0.0007
"""How far normals (rad) and values (m) of the smooth distance may be from the true ones: near edges
the ones, on the surface the others."""

STEEP = 0.93
"""Slope (-) of the smooth distance from which on a contact is off edges. The slope is the length of
the mean of the normals within the smoothing's reach: 1 on flat and evenly round places, 0.75 on a
right-angled edge. On seven meshes 99 % of the places that the verdict calls edges have less, and 60
to 100 % of the others more."""


class _MeshSurface(Surface):
    """The zero level of a mesh's smooth distance field; one object per programme."""

    kind = "mesh"

    def __init__(
        self,
        normal_error: float,
        distance_error: float,
        steep: float,
        steep_on_walls: float,
        edge_worth: float,
    ) -> None:
        """Begin to collect the points at which the programme needs the field."""
        self.field: FieldPoints = FieldPoints()
        self.normal_error, self.distance_error = normal_error, distance_error
        self._steep, self._steep_on_walls = steep, steep_on_walls
        self._edge_worth = edge_worth

    def anew(self) -> Surface:
        return _MeshSurface(
            self.normal_error,
            self.distance_error,
            self._steep,
            self._steep_on_walls,
            self._edge_worth,
        )

    def field_of(self, shape: Mesh) -> Field:
        return shape.field()

    def size(self, shape: Mesh) -> FloatArray:
        steep = self._steep_on_walls if shape.wall_thickness < WALL else self._steep
        return np.array([_steepness(shape, steep), 0.0, 0.0])

    def patches(self, shape: Mesh) -> tuple[Patch, ...]:
        return (_everywhere("surface", 2 * shape.half_extents),)

    def patch_at(self, shape: Mesh, point: FloatArray, normal: FloatArray) -> Patch:
        return self.patches(shape)[0]

    def outward_normal(self, size: Any, code: Any, p: Any) -> Any:
        gradient = self.field.on_surface(p)[1]
        return gradient / _soft_norm(gradient[0], gradient[1], gradient[2])

    def surface_error(self, size: Any, code: Any, p: Any) -> Any:
        return self.field.on_surface(p)[0]

    def flatness(self, size: Any, p: Any) -> Any:
        gradient = self.field.on_surface(p)[1]
        return self._edge_worth * (ca.sumsqr(gradient) - size[0] ** 2) / (2 * size[0])

    def clearance(self, size: Any, c: Any) -> Any:
        return self.field.value(c)


WALL = 0.006
"""Thickness (m) below which a mesh is one of thin walls, or a small solid: a cube of 18 mm."""

SAMPLES = 1000
"""Surface points from which the usual slope is estimated: on thin walls it is less everywhere."""


@lru_cache(maxsize=16)
def _steepness(mesh: Mesh, steep: float) -> float:
    """Slope (-) of the smooth distance from which on a place of a mesh is no edge."""
    points, _ = mesh.surface_samples(SAMPLES, np.random.default_rng(0))
    slopes = np.linalg.norm(mesh.field().taylor(points, 1)[:, 1:4], axis=1)
    return min(steep, float(np.median(slopes)))


_SURFACES: dict[str, Surface] = {
    s.kind: s
    for s in (
        _SphereSurface(),
        _BoxSurface(),
        _CylinderSurface(),
        _CapsuleSurface(),
        _EllipsoidSurface(),
    )
}


def mesh_surface(
    *,
    normal_error: float = NORMAL_ERROR,
    distance_error: float = DISTANCE_ERROR,
    steep: float = STEEP,
    steep_on_walls: float | None = None,
    edge_worth: float = 1.0,
) -> Surface:
    """The NLP form of a mesh.

    Args:
        normal_error: How far (rad) normals may be from the true ones.
        distance_error: How much (m) links keep away beyond what is asked for.
        steep: Slope (-) of the smooth distance from which on a contact is off edges.
        steep_on_walls: The same on an object of thin walls, where the slope varies; ``steep`` if
            None.
        edge_worth: What a slope that is missing there counts.
    """
    on_walls = steep if steep_on_walls is None else steep_on_walls
    return _MeshSurface(normal_error, distance_error, steep, on_walls, edge_worth)


def surface_of(shape: Shape) -> Surface:
    """The NLP form of a shape.

    Raises:
        ObjectError: Synthesis does not know this kind of shape.
    """
    if isinstance(shape, Mesh):
        return mesh_surface()
    if shape.kind not in _SURFACES:
        raise ObjectError(f"cannot plan on a {shape.kind!r}; use one of {sorted(_SURFACES)}")
    return _SURFACES[shape.kind]
