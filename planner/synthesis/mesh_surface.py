"""The smooth surface of a mesh in the synthesis problem, its field in expressions, any surface.

On thin walls the smooth distance is wrong: a grid that tells both sides of a wall of 1 mm apart has
a hundred million nodes, and a coarser one finds a value of 0.6 mm on the wall and a third of the
slope. In front of the wall it is right. So contact points of a grasp on thin walls are looked for
on a parallel surface, a skin of ``SKIN`` cells before the true one, and pads are shorter by as
much. Normals are the same; lever arms of tangential forces are longer by the skin, which the
verdict on the true surface is not.

Distance fields in expressions: a mesh's smooth distance by its Taylor coefficients.

A primitive's distance is an expression. A mesh has a sampled field, a table
(``planner.shapes.distance_field``). Expressions are therefore written in the field's Taylor
coefficients at the points where they need it: with the coefficients a, b, H of phi at a point y
that depends on the unknowns,

    phi(y)      = a + b . d + d'Hd/2       with d = y - y0 = 0,
    grad phi(y) = b + H d.

The first derivatives of these polynomials at d = 0 are those of phi and of its gradient, exactly.
All derivatives are taken symbolically, once; an evaluation looks the coefficients up at the present
points.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, Protocol

import casadi as ca
import numpy as np

from planner.shapes import Mesh, Shape
from planner.shapes.base import Patch, Surface, soft_norm, whole_surface
from planner.spatial import FloatArray

COEFFICIENTS = 10
"""Taylor coefficients of phi up to its second derivatives."""


class Field(Protocol):
    """The interface of a distance field for expressions."""

    def taylor(self, points: FloatArray, order: int) -> FloatArray:
        """Value and partial derivatives up to an order at points (n, 3), m: (n, 10) for two."""
        ...


class FieldPoints:
    """The points at which expressions need a field, and the symbols of its coefficients there."""

    def __init__(self) -> None:
        """Make an empty collection."""
        self._points: list[Any] = []
        self._symbols: list[Any] = []
        self._known: dict[tuple[Any, ...], tuple[Any, Any, Any]] = {}

    def __len__(self) -> int:
        """Number of points."""
        return len(self._points)

    def at(self, point: Any) -> tuple[Any, Any, Any]:
        """Value, gradient (3,) and Hessian (3, 3) of phi at a point (3,).

        Value and gradient can be differentiated once; the Hessian counts as constant.
        """
        key = tuple(point[k].element_hash() for k in range(3))
        if key not in self._known:
            symbol = ca.SX.sym(f"field_{len(self._points)}", 3 + COEFFICIENTS)
            self._points.append(point)
            self._symbols.append(symbol)
            d, b, h = point - symbol[:3], symbol[4:7], _symmetric(symbol[7:13])
            value = symbol[3] + ca.dot(b, d) + ca.dot(d, h @ d) / 2
            self._known[key] = value, b + h @ d, h
        return self._known[key]

    @property
    def points(self) -> Any:
        """All points (3, n) as an expression."""
        return ca.horzcat(*self._points)

    @property
    def symbols(self) -> Any:
        """Base point and coefficients of every point, one column (13 n,), in their order."""
        return ca.vertcat(*self._symbols)

    def coefficients(self, field: Field, points: FloatArray) -> FloatArray:
        """Numbers (13 n,) for ``symbols`` where the points are (n, 3), m."""
        return np.hstack([points, field.taylor(points, 2)]).ravel()


def _symmetric(v: Any) -> Any:
    """Symmetric (3, 3) of xx, xy, xz, yy, yz, zz."""
    return ca.vertcat(
        ca.horzcat(v[0], v[1], v[2]), ca.horzcat(v[1], v[3], v[4]), ca.horzcat(v[2], v[4], v[5])
    )


NORMAL_ERROR, DISTANCE_ERROR = 0.1, 0.0007
"""Largest errors of the smooth distance: of its normals (rad) near edges, and of its values (m) on
the surface."""

STEEP, STEEP_ON_NARROW = 0.93, 0.96
"""Least slope (-) of the smooth distance at a contact that is on no edge. The slope is the length
of the mean normal within the radius of smoothing: 1 on flat and evenly round places, 0.75 on a
right-angled edge. At 0.93 the normal is 5 degrees off and a pad of 12 mm meets the true surface 1
mm nearer to the edge: of 288 attempts at random edged parts 48 ended there, with 0.96 9."""


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
        return shape.field(fine=True)

    def size(self, shape: Mesh) -> FloatArray:
        steep = self._steep_on_walls if shape.thin_walled else self._steep
        if shape.narrow:
            steep = max(steep, STEEP_ON_NARROW)
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
        value, gradient, hessian = self.field.at(p)
        above = value - self.skin(size)
        squared = ca.sumsqr(gradient)
        # of the foot on the surface: over an edge the slope grows, and contacts would leave upwards
        squared -= 2 * above * ca.dot(gradient, hessian @ gradient) / squared
        return self._edge_worth * (squared - size[0] ** 2) / (2 * size[0])

    def clearance(self, size: Any, c: Any) -> Any:
        return self.field.at(c)[0]


class _WallSurface(_MeshSurface):
    """The parallel surface before the thin walls of a mesh; one object per problem."""

    kind = "mesh of thin walls"

    def field_of(self, shape: Mesh) -> Field:
        return shape.field()

    def size(self, shape: Mesh) -> FloatArray:
        skin = SKIN * shape.field().spacing
        return np.array([_steepness(shape, self._steep, skin), skin, 0.0])

    def skin(self, size: Any) -> Any:
        return size[1]

    def patches(self, shape: Mesh) -> tuple[Patch, ...]:
        reach = 2 * shape.half_extents + SKIN * shape.field().spacing
        return (whole_surface("surface", reach),)

    def surface_error(self, size: Any, code: Any, p: Any) -> Any:
        return self.field.at(p)[0] - self.skin(size)


SKIN = 1.5
"""Distance in front of thin walls, in cells of the field, at which its error no longer depends on
the wall: 0.12 mm in 95 % of places on cups of 0.5 to 3 mm, normals within 4 degrees in 90 %."""

STEEP_BEFORE_WALLS, EDGE_WORTH_BEFORE_WALLS = 0.99, 3.0
"""Least slope (-) in front of thin walls, and weight factor (-) of a lower one. The parallel
surface goes around a rim in a round bend, where the slope is 0.95. On five cups and bowls of 1 to
3 mm 17.5 grasps were found per CPU second with these, 12.1 with 0.93 and 1 (Allegro-type hand;
Shadow-type: 14.6 with these, 12.1 with 0.99 and 1)."""

SAMPLES = 1000
"""Surface points for the usual slope."""

MEDIAN, FLATTEST = 0.5, 0.75
"""Share of the surface that is less steep than a contact must be at most: on thin walls, which
lower the slope everywhere, and on solids, of which small ones have edges nearly everywhere."""


@lru_cache(maxsize=16)
def _steepness(mesh: Mesh, steep: float, skin: float = 0.0) -> float:
    """Least slope (-) of the smooth distance at points, a skin (m) before a mesh, on no edge."""
    points, normals = mesh.surface_samples(SAMPLES, np.random.default_rng(0))
    field = mesh.field(fine=skin == 0.0)
    slopes = np.linalg.norm(field.taylor(points + skin * normals, 1)[:, 1:4], axis=1)
    usual = np.quantile(slopes, MEDIAN if mesh.thin_walled else FLATTEST)
    return min(steep, float(usual))


def mesh_surface(
    *,
    normal_error: float = NORMAL_ERROR,
    distance_error: float = DISTANCE_ERROR,
    steep: float = STEEP,
    steep_on_walls: float = STEEP,
    edge_worth: float = 1.0,
) -> Surface:
    """The form of a mesh in a problem, with contacts on the smooth surface itself.

    Args:
        normal_error: Largest error of the normals, rad.
        distance_error: Added to every clearance of links, m.
        steep: Least slope (-) of the smooth distance at a contact that is on no edge.
        steep_on_walls: The same on an object of thin walls, where the slope varies.
        edge_worth: Weight factor (-) of a lower slope.
    """
    return _MeshSurface(normal_error, distance_error, steep, steep_on_walls, edge_worth)


def surface_of(shape: Shape) -> Surface:
    """The form of a shape in the grasp problem.

    Raises:
        ObjectError: Synthesis does not know this kind of shape.
    """
    if not isinstance(shape, Mesh):
        return shape.surface()
    if not shape.thin_walled:
        return mesh_surface()
    return _WallSurface(
        NORMAL_ERROR,
        DISTANCE_ERROR,
        STEEP_BEFORE_WALLS,
        STEEP_BEFORE_WALLS,
        EDGE_WORTH_BEFORE_WALLS,
    )
