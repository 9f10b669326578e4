"""How far apart links of a hand are at least, in microseconds: most pairs need to know no more.

Around every geometry there is a capsule, and around those that are no capsule a body of simple
form. The distance of one's capsule from the other's body is a lower bound of the geometries'
distance, and nearly equal to it where they are such forms themselves. A pair whose bound is large
enough needs no query of coal.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import coal
import numpy as np
from numpy.typing import NDArray

from planner.collision.form_kernels import (
    BOX,
    CAPSULE,
    CYLINDER,
    ELLIPSOID,
    HULL,
    bound_pairs,
    place_forms,
)
from planner.kinematics import joint_axes
from planner.spatial import SE3, FloatArray, IntArray

__all__ = ["LinkBounds"]


class LinkBounds:
    """Lower bounds of the distances of pairs among a hand's geometries and what stands around."""

    def __init__(
        self,
        pin_model: Any,
        geometries: Any,
        pairs: Sequence[tuple[int, int]],
        n_moving: int,
        points: FloatArray | None = None,
    ) -> None:
        """Find the forms; arguments as of ``planner.shapes.convex_pairs.GeometryPairs``.

        Args:
            pin_model: Pinocchio's model of the hand.
            geometries: ``pinocchio.GeometryModel``; those that stand still are the last.
            pairs: Numbers of two geometries each.
            n_moving: How many geometries move with the hand.
            points: Points (k, 3), m, whose hull holds the first of those that stand still.
        """
        objects = list(geometries.geometryObjects)
        forms = [_Form.of(g.geometry) for g in objects]
        self._kinds = np.array([f.kind for f in forms], dtype=np.int64)
        self._planes = np.zeros((0, 4))
        if points is not None:
            self._kinds[n_moving] = HULL
            offsets = (DIRECTIONS @ (points - forms[n_moving].middle).T).max(axis=1)
            self._planes = np.column_stack([DIRECTIONS, -offsets])
        self._sizes = np.array([f.size for f in forms])
        self._capsules = np.array([f.capsule for f in forms])
        self._along = np.array([f.along for f in forms], dtype=np.int64)
        self.pairs = np.array(pairs, dtype=np.int64).reshape(-1, 2)
        moving = [
            g.placement * SE3(np.eye(3), f.middle) for g, f in zip(objects, forms, strict=True)
        ]
        self._carriers = np.array([g.parentJoint for g in objects[:n_moving]], dtype=np.int64)
        self._bodies = _matrices(moving[:n_moving])
        self._fixed_middles = [f.middle for f in forms[n_moving:]]
        self._parents = np.array(list(pin_model.parents), dtype=np.int64)
        self._joints = _matrices(list(pin_model.jointPlacements))
        self._axes = joint_axes(pin_model)

    def place(self, q: FloatArray, fixed: Sequence[SE3]) -> FloatArray:
        """Poses (b, n, 3, 4) of all forms at configurations, in the base.

        Args:
            q: Configurations (b, nq).
            fixed: Poses in the base of what stands around.
        """
        n = len(self._carriers)
        out = np.empty((len(q), n + len(fixed), 3, 4))
        out[:, :n] = place_forms(
            q, self._parents, self._joints, self._axes, self._carriers, self._bodies
        )
        for i, (pose, middle) in enumerate(zip(fixed, self._fixed_middles, strict=True), n):
            out[:, i, :, :3], out[:, i, :, 3] = pose.rotation, pose.act(middle)
        return out

    def at(self, poses: FloatArray, pairs: IntArray, limits: FloatArray) -> FloatArray:
        """Lower bounds (b, k) of distances, m; rough ones from a limit on.

        Where two geometries meet, the bound is negative, but not of their depth.

        Args:
            poses: (b, n, 3, 4), see ``place``.
            pairs: Numbers of pairs (k,).
            limits: (b,), m.
        """
        return bound_pairs(
            poses,
            self._kinds,
            self._sizes,
            self._capsules,
            self._along,
            self._planes,
            self.pairs[pairs],
            limits,
        )

    def clear_along(
        self, poses: FloatArray, pairs: IntArray, way: FloatArray, clearance: float
    ) -> NDArray[np.bool_]:
        """Which pairs (k,) keep a clearance (m) for certain while the hand moves straight.

        Args:
            poses: At the beginning, (1, n, 3, 4), see ``place``.
            pairs: Numbers of pairs (k,) of hand and surroundings.
            way: How the hand moves, (3,), m, base axes.
            clearance: m.
        """
        length = math.sqrt(float(way @ way))
        if length == 0.0:
            return np.asarray(self.at(poses, pairs, np.array([clearance]))[0] >= clearance)
        places = np.minimum(PLACES, length)
        gaps = places[1:] - places[:-1]
        around = np.full(len(places), clearance)
        around[:-1] += gaps
        around[1:] = np.maximum(around[1:], clearance + gaps)
        along = np.repeat(poses, len(places), axis=0)
        along[:, len(self._carriers) :, :, 3] -= (places / length)[:, None, None] * way
        found = self.at(along, pairs, around)
        # between two places a distance changes by no more than the way between them
        between = (found[1:] + found[:-1] - gaps[:, None]) / 2.0
        return np.asarray(between.min(axis=0) >= clearance)


def _directions(count: int) -> FloatArray:
    """The axes, and directions spread evenly over the sphere by the golden angle, (count, 3)."""
    k = np.arange(count - 6) + 0.5
    height, turn = 1.0 - 2.0 * k / (count - 6), np.pi * (1.0 + 5.0**0.5) * k
    wide = np.sqrt(1.0 - height**2)
    spread = np.column_stack([wide * np.cos(turn), wide * np.sin(turn), height])
    return np.vstack([np.eye(3), -np.eye(3), spread])


DIRECTIONS = _directions(134)
"""Normals of the planes about a hull (134, 3): 16 degrees apart."""

FIRST_PLACE, GROWTH, N_PLACES = 0.0005, 1.35, 24
PLACES = np.append(0.0, FIRST_PLACE * (GROWTH ** np.arange(N_PLACES) - 1.0) / (GROWTH - 1.0))
"""Where along a way (m) bounds are taken: near its beginning, where a grasp is left, 0.5 mm apart,
and ever farther, up to 1.9 m."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Form:
    """What stands for a geometry: a body, and the capsule around it.

    Attributes:
        kind: Its form.
        size: Half extents (3,), m; of a capsule they are not used.
        middle: Centre in the geometry's frame (3,), m.
        capsule: Half length of the capsule's axis and its radius, m.
        along: Which axis of the body the capsule's is.
    """

    kind: int
    size: FloatArray
    middle: FloatArray
    capsule: tuple[float, float]
    along: int

    @classmethod
    def of(cls, geometry: Any) -> _Form:
        """The form of a geometry of coal; its bounding box where it is none of them."""
        middle, along = np.zeros(3), 2
        if isinstance(geometry, coal.Sphere | coal.Capsule):
            length = 0.0 if isinstance(geometry, coal.Sphere) else float(geometry.halfLength)
            capsule = (length, float(geometry.radius))
            return cls(kind=CAPSULE, size=np.ones(3), middle=middle, capsule=capsule, along=along)
        if isinstance(geometry, coal.Cylinder):
            radius, half = float(geometry.radius), float(geometry.halfLength)
            size, capsule = np.array([radius, radius, half]), (half, radius)
            return cls(kind=CYLINDER, size=size, middle=middle, capsule=capsule, along=along)
        if isinstance(geometry, coal.Ellipsoid):
            size = np.array(geometry.radii)
            along = int(size.argmax())
            wide = float(np.sort(size)[1])
            capsule = (float(size[along]) - wide, wide)
            return cls(kind=ELLIPSOID, size=size, middle=middle, capsule=capsule, along=along)
        geometry.computeLocalAABB()
        lower, upper = (np.array(v) for v in (geometry.aabb_local.min_, geometry.aabb_local.max_))
        size, middle = (upper - lower) / 2.0, (upper + lower) / 2.0
        along = int(size.argmax())
        capsule = (float(size[along]), float(np.linalg.norm(np.delete(size, along))))
        return cls(kind=BOX, size=size, middle=middle, capsule=capsule, along=along)


def _matrices(poses: Sequence[SE3]) -> FloatArray:
    """(n, 3, 4), [rotation, position] of poses."""
    return np.array([p.homogeneous[:3] for p in poses]).reshape(-1, 3, 4)
