"""``ConvexBodies``: convex geometries as arrays for compiled loops, see ``gap_loops``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import coal
import numpy as np

from planner.proximity.gap_loops import BOX, CYLINDER, ELLIPSOID, POINTS
from planner.spatial import FloatArray, IntArray

__all__ = ["ConvexBodies"]


@dataclass(frozen=True, kw_only=True, eq=False)
class ConvexBodies:
    """n convex geometries: a core and a radius around it each.

    Attributes:
        kinds: Of the cores (n,), see ``planner.proximity.gap_loops``.
        sizes: Half extents of the core, or of the box around its points, and the radius, (n, 4), m.
        middles: Where the middle of each core is in its geometry's frame (n, 3), m.
        points: Points of all hulls (k, 3), m, about their middles.
        first: Where those of each body begin (n + 1,).
    """

    kinds: IntArray
    sizes: FloatArray
    middles: FloatArray
    points: FloatArray
    first: IntArray

    @property
    def arrays(self) -> tuple[IntArray, FloatArray, FloatArray, IntArray]:
        """What loops take: ``kinds``, ``sizes``, ``points``, ``first``."""
        return self.kinds, self.sizes, self.points, self.first

    @property
    def are_balls(self) -> bool:
        """Whether all are balls."""
        return not self.sizes[:, :3].any()

    @classmethod
    def of(cls, geometries: Sequence[Any]) -> ConvexBodies | None:
        """Of coal geometries; None if one of them is of no such form."""
        known = [_body(g) for g in geometries]
        bodies = [body for body in known if body is not None]
        if len(bodies) < len(known):
            return None
        counts = [len(points) for _, _, _, points in bodies]
        return cls(
            kinds=np.array([kind for kind, _, _, _ in bodies], dtype=np.int64),
            sizes=np.array([size for _, size, _, _ in bodies], dtype=np.float64).reshape(-1, 4),
            middles=np.array([middle for _, _, middle, _ in bodies]).reshape(-1, 3),
            points=np.vstack([np.zeros((0, 3)), *(points for _, _, _, points in bodies)]),
            first=np.concatenate([[0], np.cumsum(counts, dtype=np.int64)]).astype(np.int64),
        )


_Body = tuple[int, tuple[float, ...], FloatArray, FloatArray]
"""Kind, half extents and radius, middle, points."""


def _body(geometry: Any) -> _Body | None:
    none, origin = np.zeros((0, 3)), np.zeros(3)
    if isinstance(geometry, coal.Sphere):
        return BOX, (0.0, 0.0, 0.0, geometry.radius), origin, none
    if isinstance(geometry, coal.Capsule):
        return BOX, (0.0, 0.0, geometry.halfLength, geometry.radius), origin, none
    if isinstance(geometry, coal.Box):
        return BOX, (*geometry.halfSide, 0.0), origin, none
    if isinstance(geometry, coal.Cylinder):
        radius = geometry.radius
        return CYLINDER, (radius, radius, geometry.halfLength, 0.0), origin, none
    if isinstance(geometry, coal.Ellipsoid):
        return ELLIPSOID, (*geometry.radii, 0.0), origin, none
    if isinstance(geometry, coal.ConvexBase):
        points = np.array(geometry.points())
        lower, upper = points.min(axis=0), points.max(axis=0)
        middle = (lower + upper) / 2
        return POINTS, (*(upper - lower) / 2, 0.0), middle, points - middle
    return None
