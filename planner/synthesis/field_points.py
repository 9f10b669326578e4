"""Distance fields in expressions: a mesh's smooth distance by its Taylor coefficients.

A primitive's distance is an expression. A mesh has a sampled field, a table
(``planner.shapes.field.distance_field``). Expressions are therefore written in the field's Taylor
coefficients at the points where they need it: with the coefficients a, b, H of phi at a point y
that depends on the unknowns,

    phi(y)      = a + b . d + d'Hd/2       with d = y - y0 = 0,
    grad phi(y) = b + H d.

The first derivatives of these polynomials at d = 0 are those of phi and of its gradient, exactly.
All derivatives are taken symbolically, once; an evaluation looks the coefficients up at the present
points.
"""

from __future__ import annotations

from typing import Any, Protocol

import casadi as ca
import numpy as np

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
