"""Box."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from typing import Any, ClassVar

import coal
import numpy as np

from planner.shapes.base import (
    ALIGNED,
    CODE_DIM,
    KEPT,
    ON_SURFACE,
    Boxed,
    Patch,
    Surface,
    box_clearance,
    checked_points,
    edge_margin,
    sign,
)
from planner.shapes.hulls import StablePose, stable_poses
from planner.spatial import FloatArray, fixed_array


@dataclass(frozen=True)
class Box(Boxed):
    """A box.

    Attributes:
        size: Full extents x, y, z, m.
    """

    kind: ClassVar[str] = "box"
    default_sizes: ClassVar[tuple[float, ...]] = (0.05, 0.05, 0.08)
    size: tuple[float, float, float]

    @property
    def bounding_radius(self) -> float:
        """Half the space diagonal, m."""
        return float(np.linalg.norm(self.half_extents))

    @property
    def volume(self) -> float:
        """Product of the full extents, m3."""
        return float(np.prod(self.size))

    def inertia(self, mass: float) -> FloatArray:
        """Diagonal m/12 (y^2 + z^2), m/12 (z^2 + x^2), m/12 (x^2 + y^2); (3, 3), kg m2."""
        squares = np.array(self.size) ** 2
        return np.diag(mass / 12 * (squares.sum() - squares))

    def coal_geometry(self) -> Any:
        """``coal.Box``, which takes full extents."""
        return coal.Box(*self.size)

    def mujoco_geom(self) -> tuple[str, tuple[float, ...]]:
        """Type "box", size: half extents."""
        x, y, z = self.size
        return "box", (x / 2, y / 2, z / 2)

    def closest_point(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See ``Shape``; inside, the nearest face."""
        p, half = checked_points(points), self.half_extents
        clamped = p.clip(-half, half)
        gap = p - clamped
        distance = np.sqrt((gap * gap).sum(axis=1))
        outside = distance > ON_SURFACE
        surface, normal = clamped, gap / np.where(outside, distance, 1.0)[:, None]
        if not outside.all():
            row = np.flatnonzero(~outside)
            face = (half - np.abs(p[row])).argmin(axis=1)
            side = sign(p[row, face])
            surface[row], normal[row] = p[row], 0.0
            surface[row, face], normal[row, face] = side * half[face], side
        return surface, normal

    def resting_poses(self) -> tuple[StablePose, ...]:
        """Standing as it is, then on each of the other faces, those that tilt farthest first."""
        corners = np.array(list(product((-1.0, 1.0), repeat=3))) * self.half_extents
        poses = stable_poses(corners)
        standing = StablePose(rotation=np.eye(3), height=self.size[2] / 2)
        others = [p for p in poses if not np.allclose(p.rotation, np.eye(3))]
        kept = [p for p in poses if np.allclose(p.rotation, np.eye(3))]
        return (*(kept or [standing]), *others)

    def support(self, direction: FloatArray) -> float:
        """Sum of |direction_i| half_i, m."""
        return float(np.abs(direction) @ self.half_extents)

    @property
    def flat_sides(self) -> FloatArray | None:
        """+x, +y, +z, -x, -y, -z, (6, 3)."""
        return _SIDES

    def curvature_and_edges(
        self, points: FloatArray, normals: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Flat on a face; the edge is the nearest one of that face."""
        curvature, gap = super().curvature_and_edges(points, normals)
        face = np.abs(normals) > 1.0 - ALIGNED
        gaps = np.where(face, np.inf, self.half_extents - np.abs(points)).min(axis=1)
        flat = face.any(axis=1)
        curvature[flat], gap[flat] = np.inf, gaps[flat]
        return curvature, gap

    def surface(self) -> Surface:
        """See ``Shape``."""
        return _SURFACE


_SIDES = fixed_array(np.vstack([np.eye(3), -np.eye(3)]))


class _BoxSurface(Surface):
    kind = "box"

    def size(self, shape: Box) -> FloatArray:
        return np.array(shape.half_extents)

    def patches(self, shape: Box) -> tuple[Patch, ...]:
        return _patches(shape)

    def patch_at(self, shape: Box, point: FloatArray, normal: FloatArray) -> Patch:
        return max(self.patches(shape), key=lambda patch: float(patch.code @ normal))

    def outward_normal(self, size: Any, code: Any, p: Any) -> Any:
        return code

    def surface_error(self, size: Any, code: Any, p: Any) -> Any:
        return None

    def clearance(self, size: Any, c: Any) -> Any:
        return box_clearance(size, c)


@lru_cache(maxsize=KEPT)
def _patches(shape: Box) -> tuple[Patch, ...]:
    half = shape.half_extents
    out = []
    for axis in range(3):
        for side in (1.0, -1.0):
            code = np.zeros(CODE_DIM)
            code[axis] = side
            reach = half - np.array([edge_margin(h) for h in half])
            lower, upper = -reach, reach.copy()
            lower[axis] = upper[axis] = side * half[axis]
            name = ("+" if side > 0 else "-") + "xyz"[axis]
            out.append(Patch(name=name, code=code, lower=lower, upper=upper))
    return tuple(out)


_SURFACE = _BoxSurface()
