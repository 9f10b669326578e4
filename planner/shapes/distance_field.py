"""A smooth signed distance with exact derivatives, defined in all of space, for contact synthesis.

A ``DistanceField`` is a cubic B-spline on nested grids. The finest covers the surface and a few
centimetres around it; the spacing of each coarser one is a multiple of it. A finer level is the
coarser one, refined to the finer grid by the two-scale relation of B-splines, plus a correction
whose outermost coefficients are zero. So value, gradient and Hessian are continuous across the rims
of the levels too. Beyond the coarsest level the value is |p| - r, to which the coarsest level is
blended before its rim; what is left of a step there is below ``planner.shapes.field_fit.RIM_STEP``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import combinations_with_replacement
from math import comb

import numpy as np
from numpy.typing import NDArray

from planner.errors import ObjectError, shown
from planner.shapes.base import Shape
from planner.spatial import FloatArray, IntArray

ORDERS = (0, 1, 2)
"""Orders of the derivatives that are continuous."""

FIELD_VERSION = "v7"
"""Part of the key of fields on disk: to be changed whenever a fitted field would change."""

FIT = 1e-6
"""Distance (m) by which a kept field may be worse than the error that it states."""

CHECKED = 256
"""Vertices of a mesh, about, at which a kept field is checked, and points in its bounding box."""

# Pieces of the cubic B-spline on a cell as polynomials of t in [0, 1]: row = power of t, column =
# coefficient i-1 .. i+2 (de Boor, "A practical guide to splines", uniform knots).
_PIECES = np.array([[1, 4, 1, 0], [-3, 0, 3, 0], [3, -6, 3, 0], [-1, 3, -3, 1]]) / 6.0


def taylor_size(order: int) -> int:
    """Partial derivatives in 3D up to an order: 1, 4, 10."""
    return comb(order + 3, 3)


@dataclass(frozen=True, kw_only=True, eq=False)
class Level:
    """One grid of spline coefficients.

    Attributes:
        first: Index (3,) of the first coefficient's node; node k is at k times the spacing.
        spacing: m.
        coefficients: (nx, ny, nz), m; at least four along each axis.
    """

    first: IntArray
    spacing: float
    coefficients: FloatArray

    @property
    def lower(self) -> FloatArray:
        """Lower corner (3,) of where the spline is defined, m."""
        return np.asarray((self.first + 1) * self.spacing)

    @property
    def upper(self) -> FloatArray:
        """Upper corner (3,), m."""
        shape = np.array(self.coefficients.shape)
        return np.asarray((self.first + shape - 2) * self.spacing)


@dataclass(frozen=True, kw_only=True, eq=False)
class DistanceField:
    """Smooth signed distance; see the module.

    Attributes:
        levels: From the finest to the coarsest.
        far_radius: Radius r of the far distance |p| - r, m.
        error: How far (m) the value is from the true distance at most, within the solid's bounding
            box: proven when the field is fitted, see ``planner.shapes.field_fit.error_bound``.
        tables: The levels as the evaluation reads them.
    """

    levels: tuple[Level, ...]
    far_radius: float
    error: float
    tables: Tables = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Lay out the tables of the evaluation."""
        object.__setattr__(self, "tables", Tables(self.levels))

    @property
    def spacing(self) -> float:
        """Spacing of the finest grid, m."""
        return self.levels[0].spacing

    def taylor(self, points: FloatArray, order: int = 2) -> FloatArray:
        """Value and partial derivatives at points.

        Args:
            points: (n, 3), m, in the shape's frame; anywhere.
            order: Highest order of the derivatives, 0 to 2.

        Returns:
            (n, ``taylor_size(order)``), units m^(1 - order of the derivative), in the order [phi,
            x, y, z, xx, xy, xz, yy, yz, zz].

        Raises:
            ObjectError: Not finite, not of shape (n, 3), or another order.
        """
        p = np.asarray(points, dtype=np.float64)
        if p.ndim != 2 or p.shape[1] != 3:
            raise ObjectError(f"points have shape {p.shape}; give an array of shape (n, 3), in m")
        if order not in ORDERS:
            raise ObjectError(
                f"order is {shown(order)}; give the order of a derivative, one of {ORDERS}"
            )
        out, inside = self.tables.evaluate(p, order)
        if not inside.all():
            far = ~inside
            if not np.isfinite(p).all():
                raise ObjectError("points hold NaN or infinity; give finite coordinates in metres")
            out[far] = _far_taylor(p[far], self.far_radius, order)
        return out

    def value(self, points: FloatArray) -> FloatArray:
        """Smooth signed distance (n,), m, of points (n, 3), m."""
        out: FloatArray = self.taylor(points, 0)[:, 0]
        return out

    def fits(self, mesh: Shape, corners: FloatArray) -> bool:
        """Whether it is within its own error of a mesh's distance, at points in the mesh's box.

        Args:
            mesh: The mesh for which it was kept.
            corners: Its vertices (n, 3), m.
        """
        numbers = [self.far_radius, self.error, *(level.spacing for level in self.levels)]
        if not np.isfinite(numbers).all() or min(numbers) <= 0 or self.error > mesh.bounding_radius:
            return False
        if not all(np.isfinite(level.coefficients).all() for level in self.levels):
            return False
        lower, upper = corners.min(axis=0), corners.max(axis=0)
        inside = np.random.default_rng(0).uniform(lower, upper, (CHECKED, 3))
        points = np.concatenate([corners[:: max(1, len(corners) // CHECKED)], inside])
        off = np.abs(self.value(points) - mesh.signed_distance(points))
        return bool(off.max() <= self.error + FIT)

    def rough_value(self, points: FloatArray) -> FloatArray:
        """Distance (n,), m, at the nodes nearest to points (n, 3): in a fifth of the time.

        Off by up to a little more than a spacing of the level that a point is in.
        """
        out: FloatArray = np.linalg.norm(points, axis=1) - self.far_radius
        for level in reversed(self.levels):  # the finest one that holds a point is the last
            node = np.rint(points / level.spacing).astype(np.int64) - level.first
            held = ((node >= 0) & (node < level.coefficients.shape)).all(axis=1)
            out[held] = level.coefficients[tuple(node[held].T)]
        return out

    def to_arrays(self) -> dict[str, FloatArray]:
        """As named arrays, for a file."""
        out: dict[str, FloatArray] = {
            "far_radius": np.array([self.far_radius]),
            "error": np.array([self.error]),
        }
        for i, level in enumerate(self.levels):
            out[f"place{i}"] = np.array([*level.first, level.spacing], dtype=np.float64)
            out[f"coefficients{i}"] = level.coefficients
        return out

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, FloatArray]) -> DistanceField:
        """What ``to_arrays`` gave; KeyError or ValueError where the arrays are not of that form."""
        levels: list[Level] = []
        while f"place{len(levels)}" in arrays:
            x, y, z, spacing = arrays[f"place{len(levels)}"]
            coefficients = np.asarray(arrays[f"coefficients{len(levels)}"], dtype=np.float64)
            if coefficients.ndim != 3 or min(coefficients.shape) < 4:
                raise ValueError(f"coefficients of shape {coefficients.shape}")
            first = np.array([x, y, z]).astype(np.int64)
            levels.append(Level(first=first, spacing=float(spacing), coefficients=coefficients))
        if not levels:
            raise KeyError("place0")
        return cls(
            levels=tuple(levels),
            far_radius=float(arrays["far_radius"][0]),
            error=float(arrays["error"][0]),
        )


class Tables:
    """All levels in flat arrays, so that points of different levels are evaluated together.

    Attributes:
        flat: Coefficients of all levels one after the other, each level by rows (k,), m.
        first: Node at which cell 0 of each level begins (n_levels, 3).
        inverse: 1 / spacing (n_levels, 1), 1/m.
        last_cell: (n_levels, 3).
        strides: Of each level along the axes (n_levels, 3).
        start: Where each level begins in ``flat`` (n_levels,).
        centre: Of the box of each level (n_levels, 1, 3), m.
        reach: Its half extents (n_levels, 1, 3), m.
    """

    def __init__(self, levels: tuple[Level, ...]) -> None:
        """Lay out."""
        self.flat = np.concatenate([level.coefficients.ravel() for level in levels])
        # cell k of a level lies between its nodes k + 1 and k + 2
        self.first = np.array([level.first + 1 for level in levels], dtype=np.float64)
        self.inverse = np.array([[1.0 / level.spacing] for level in levels])  # (n_levels, 1)
        # per cell width^derivative to per m^derivative, (10, n_levels)
        self.scale = (self.inverse ** _MIXED.sum(axis=0)).T
        n = len(levels)
        self.level_of = np.array([n - 1, *range(n - 1, -1, -1)])  # of how many levels hold a point
        shapes = np.array([level.coefficients.shape for level in levels])
        self.last_cell = shapes - 4  # the first of the four coefficients of the last cell
        self.cells = (shapes[0] - 3).astype(np.float64)  # of the finest level, which comes first
        self.strides = np.column_stack(
            [shapes[:, 1] * shapes[:, 2], shapes[:, 2], np.ones(len(levels), dtype=np.int64)]
        )
        self.start = np.concatenate([[0], np.cumsum(shapes.prod(axis=1))[:-1]])
        i, j, k = np.meshgrid(*[np.arange(4)] * 3, indexing="ij")
        self.stencil = np.stack(  # (64, n_levels)
            [(s[0] * i + s[1] * j + s[2] * k).ravel() for s in self.strides], axis=1
        )
        lower = np.array([[level.lower] for level in levels])  # (n_levels, 1, 3)
        upper = np.array([[level.upper] for level in levels])
        self.centre, self.reach = (lower + upper) / 2, (upper - lower) / 2

    def evaluate(self, p: FloatArray, order: int) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Taylor rows (n, size) and, (n,), whether the point is in any level."""
        u = p * self.inverse[0] - self.first[0]
        if len(p) and u.min() >= 0.0 and (u < self.cells).all():
            # near the surface, as they nearly always are: all in the finest level
            cell = u.astype(np.int64)
            c = self.flat.take(self.stencil[:, :1] + cell @ self.strides[0])
            out = _combined(c, (u - cell).T, order)
            out *= self.scale[: len(out), :1]
            return np.ascontiguousarray(out.T), np.ones(len(p), dtype=bool)
        return self._evaluate_mixed(p, order)

    def _evaluate_mixed(self, p: FloatArray, order: int) -> tuple[FloatArray, NDArray[np.bool_]]:
        # the levels are nested: the finest that holds a point follows from how many hold it
        held = (np.abs(p - self.centre) <= self.reach).all(axis=2).sum(axis=0)
        inside, which = held > 0, self.level_of[held]
        u = p * self.inverse.take(which, axis=0) - self.first.take(which, axis=0)
        if not inside.all():
            u[~inside] = 0.0
        cell = np.minimum(np.maximum(u, 0.0).astype(np.int64), self.last_cell.take(which, axis=0))
        base = (cell * self.strides.take(which, axis=0)).sum(axis=1) + self.start.take(which)
        c = self.flat.take(self.stencil.take(which, axis=1) + base)  # (64, n), z fastest
        out = _combined(c, (u - cell).T, order)
        out *= self.scale[: len(out)].take(which, axis=1)
        return np.ascontiguousarray(out.T), inside


def _combined(c: FloatArray, t: FloatArray, order: int) -> FloatArray:
    """Derivatives (size, n), per cell width, of coefficients (64, n) at places (3, n) in a cell."""
    w = _weights(t, order)  # (order + 1, 4, 3, n)
    n, (dx, dy, dz) = c.shape[1], _MIXED[:, : taylor_size(order)]
    # along z first; then x and y together, for the wanted mixed derivatives only
    along_z = np.einsum("azn,dzn->dan", c.reshape(16, 4, n), w[:, :, 2])
    across = w[:, :, 0].take(dx, axis=0)[:, :, None] * w[:, :, 1].take(dy, axis=0)[:, None]
    out: FloatArray = np.einsum(
        "dan,dan->dn", along_z.take(dz, axis=0), across.reshape(len(dx), 16, n)
    )
    return out


def _weights(t: FloatArray, order: int) -> FloatArray:
    """Weights of the four coefficients, (order + 1, 4, 3, n), per cell width^derivative."""
    powers = np.empty((4, *t.shape))
    powers[0], powers[1] = 1.0, t
    np.multiply(t, t, out=powers[2])
    np.multiply(powers[2], t, out=powers[3])
    weights = _PIECES_OF[: 4 * (order + 1)] @ powers.reshape(4, -1)
    return weights.reshape(order + 1, 4, *t.shape)


def _derived_pieces() -> FloatArray:
    """Polynomials of the pieces and their derivatives: (4 derivative + coefficient, power)."""
    out = np.zeros((len(ORDERS), 4, 4))
    pieces = _PIECES.copy()
    for d in ORDERS:
        out[d] = pieces.T
        pieces = np.vstack([pieces[1:] * np.arange(1, 4)[:, None], np.zeros((1, 4))])
    return out.reshape(-1, 4)


_PIECES_OF = _derived_pieces()


_AXES = [axes for order in ORDERS for axes in combinations_with_replacement(range(3), order)]
"""Axes of the derivative in each column of the Taylor rows."""

_MIXED = np.array([[axes.count(k) for axes in _AXES] for k in range(3)])
"""(3, 10): order of the derivative along x, y, z in each column."""


def _far_taylor(p: FloatArray, radius: float, order: int) -> FloatArray:
    """Taylor rows of |p| - radius, away from the origin."""
    r = np.linalg.norm(p, axis=1)
    e = p / r[:, None]
    out = np.empty((len(p), taylor_size(order)))
    for k, axes in enumerate(_AXES[: out.shape[1]]):
        if len(axes) == 0:
            out[:, k] = r - radius
        elif len(axes) == 1:
            out[:, k] = e[:, axes[0]]
        else:
            i, j = axes
            out[:, k] = (float(i == j) - e[:, i] * e[:, j]) / r
    return out
