"""``CollisionWorld``: all distances of a hand from object, table, obstacles and itself, at one q.

Pinocchio places the true geometries; pairs near enough by their bounding balls are measured by
``planner.proximity``.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
import pinocchio as pin

from planner.errors import NotFoundError, TaskError
from planner.mesh_proximity import MeshPair
from planner.proximity import DistancePair, Proximity
from planner.shapes import Box, Mesh, Shape
from planner.spatial import SE3, FloatArray
from planner.task import GraspTask

__all__ = [
    "TABLE_SIZE",
    "Clearance",
    "CollisionWorld",
    "bounding_radius",
    "least_distance",
    "shape_pair",
]

OBJECT = "object"
TABLE = "table"

TABLE_SIZE = (2.0, 2.0, 0.1)
"""Full extents (m) of the table: wide enough for any hand, centred under the object."""


OVERLAP_TOL = 1e-5
"""Depth (m) to which the object may be inside table or obstacle: rounding, and coal's accuracy."""

FAR = 0.03
"""Pairs further apart (m) than this by their bounding balls are not measured exactly."""


@dataclass(frozen=True, kw_only=True)
class Clearance:
    """Signed distance of one pair: positive apart, negative in penetration.

    Attributes:
        first: Name of a hand geometry.
        second: Name of another one, "object", "table", or an obstacle's name.
        distance: m.
    """

    first: str
    second: str
    distance: float

    def __str__(self) -> str:
        """Names and distance in mm."""
        return f"{self.first} - {self.second}: {1e3 * self.distance:.2f} mm"


class CollisionWorld:
    """The true geometry of a task, ready to be asked at many configurations.

    Attributes:
        task: The task.
        surroundings: Names of all that is not the hand: object, table, obstacles.
    """

    def __init__(self, task: GraspTask) -> None:
        """Collect the geometries and the pairs that must not touch.

        Raises:
            TaskError: Two geometries have one name, so that a verdict could not tell them apart;
                or table or an obstacle is in the object.
        """
        self.task = task
        hand = task.hand
        model = pin.GeometryModel()
        names = []
        for g in hand.geometries:
            model.addGeometryObject(
                pin.GeometryObject(g.name, g.joint_id, g.T_joint_geometry, g.geometry)
            )
            names.append(g.name)
        n_hand = len(names)
        fixed: list[tuple[str, SE3, Shape]] = [(OBJECT, task.T_world_object, task.object.shape)]
        if task.table_height is not None:
            top = np.array([*task.T_world_object.translation[:2], task.table_height])
            center = top - np.array([0.0, 0.0, TABLE_SIZE[2] / 2])
            fixed.append((TABLE, SE3(np.eye(3), center), Box(TABLE_SIZE)))
        for o in task.obstacles:
            x, y, z = (float(v) for v in o.size)
            fixed.append((o.name, o.T_world_obstacle, Box((x, y, z))))
        for name, pose, shape in fixed:
            model.addGeometryObject(pin.GeometryObject(name, 0, pose, shape.coal_geometry()))
            names.append(name)
        self._fixed = [(pose, shape) for _, pose, shape in fixed]
        twice = sorted(name for name, count in Counter(names).items() if count > 1)
        if twice:
            raise TaskError(
                f"several of obstacles, object, table and hand geometries are called {twice}; name "
                "each obstacle differently"
            )
        for name, pose, shape in fixed[1:]:
            query = shape_pair(shape.coal_geometry(), task.object.shape)
            depth = -query.distance(pose, task.T_world_object)
            if depth > OVERLAP_TOL:
                raise TaskError(
                    f"the object is {1e3 * depth:.2f} mm inside {name!r}; move them apart"
                )
        pairs = [
            (a, b)
            for a, b in combinations(range(n_hand), 2)
            if frozenset((names[a], names[b])) not in hand.allowed_pairs
        ]
        # an arm stands on the table
        standing = {g.name for g in hand.geometries if hand.arm is not None and g.joint_id == 0}
        pairs += [
            (a, b)
            for a in range(n_hand)
            for b in range(n_hand, len(names))
            if not (names[a] in standing and names[b] == TABLE)
        ]
        self.surroundings = frozenset(names[n_hand:])
        self._radii = np.array([bounding_radius(g.geometry) for g in model.geometryObjects])
        self._first = np.array([a for a, _ in pairs])
        self._second = np.array([b for _, b in pairs])
        self._n_hand = n_hand
        self._pairs = [(names[a], names[b]) for a, b in pairs]
        self._names = tuple(names)
        self._queries: dict[tuple[int, int], DistancePair | MeshPair] = {}
        self._object = n_hand
        self._outward = np.array([second in self.surroundings for _, second in self._pairs])
        arm = hand.arm.geometries if hand.arm is not None else frozenset()
        self._of_arm = np.array([a in arm or b in arm for a, b in self._pairs])
        self._on_object = np.array([b == OBJECT for _, b in self._pairs])
        self._model = model
        self._data = pin.GeometryData(model)
        self._pin_data = hand.pin_model.createData()

    def distances(self, T_world_base: SE3, q: FloatArray) -> list[Clearance]:
        """Signed distance of every pair at base pose and q (nq,)."""
        values = self._compute(T_world_base, q)
        return [
            Clearance(first=a, second=b, distance=float(d))
            for (a, b), d in zip(self._pairs, values, strict=True)
        ]

    def nearest(
        self, T_world_base: SE3, q: FloatArray, *, surroundings_only: bool = False
    ) -> Clearance:
        """The pair of smallest signed distance; of hand and surroundings only if asked."""
        bounds = self._bounds(T_world_base, q)
        if surroundings_only:
            bounds = np.where(self._outward, bounds, np.inf)
        return self._nearest(bounds)

    def nearest_on_arm(
        self, T_world_base: SE3, q: FloatArray, *, T_world_object: SE3 | None = None
    ) -> Clearance:
        """The pair of smallest signed distance among those that change when the arm moves.

        Arm and hand against the surroundings, and the arm against itself and the hand.

        Args:
            T_world_base: Pose of the arm's root.
            q: Joints (nq,).
            T_world_object: Where the object is if the hand holds it; only the arm's distance from
                it counts then.
        """
        moving = self._outward | self._of_arm
        if T_world_object is None:
            return self._nearest(np.where(moving, self._bounds(T_world_base, q), np.inf))
        (where, shape), self._fixed[0] = self._fixed[0], (T_world_object, self._fixed[0][1])
        try:
            moving = moving & ~(self._on_object & ~self._of_arm)
            return self._nearest(np.where(moving, self._bounds(T_world_base, q), np.inf))
        finally:
            self._fixed[0] = (where, shape)

    def _nearest(self, bounds: FloatArray) -> Clearance:
        """The pair of smallest signed distance, given lower bounds of all where things are."""
        nearest, smallest = 0, np.inf
        # pairs in the order of their bounds, until a bound exceeds the smallest distance: exact
        for k in np.argsort(bounds):
            if bounds[k] >= smallest:
                break
            distance = self._exact(int(k))
            if distance < smallest:
                nearest, smallest = int(k), distance
        first, second = self._pairs[nearest]
        return Clearance(first=first, second=second, distance=smallest)

    def proximity(self, T_world_base: SE3, q: FloatArray, first: str, second: str) -> Proximity:
        """Signed distance, nearest points and normal (world) of any two geometries by name.

        Raises:
            NotFoundError: No geometry has that name.
        """
        for name in (first, second):
            if name not in self._names:
                raise NotFoundError("geometry", name, self._names)
        self._place(T_world_base, q)
        a, b = self._names.index(first), self._names.index(second)
        return self._pair(a, b).query(
            T_world_base * self._data.oMg[a], T_world_base * self._data.oMg[b]
        )

    def _compute(self, T_world_base: SE3, q: FloatArray) -> FloatArray:
        """Signed distance of every pair; beyond ``FAR`` a lower bound."""
        values = self._bounds(T_world_base, q)
        for k in np.flatnonzero(values < FAR):
            values[k] = self._exact(int(k))
        return values

    def _exact(self, k: int) -> float:
        """Signed distance of pair k where everything was last placed."""
        a, b = int(self._first[k]), int(self._second[k])
        return self._pair(a, b).distance(self._data.oMg[a], self._data.oMg[b])

    def _bounds(self, T_world_base: SE3, q: FloatArray) -> FloatArray:
        """Place everything; lower bounds of all distances, from the hand's bounding balls.

        Balls against balls within the hand, balls against the exact shape of what stands around.
        """
        self._place(T_world_base, q)
        n = self._n_hand
        centers = np.array([placement.translation for placement in self._data.oMg])[:n]
        inside = self._second < n
        first, second = self._first[inside], self._second[inside]
        gaps = centers[first] - centers[second]
        bounds = np.empty(len(self._first))
        bounds[inside] = np.sqrt(np.einsum("ij,ij->i", gaps, gaps))
        bounds[inside] -= self._radii[first] + self._radii[second]
        for i, (pose, shape) in enumerate(self._fixed):
            to_shape = pose.inverse() * T_world_base
            local = centers @ to_shape.rotation.T + to_shape.translation
            mine = self._second == n + i
            bounds[mine] = (least_distance(shape, local) - self._radii[:n])[self._first[mine]]
        return bounds

    def _place(self, T_world_base: SE3, q: FloatArray) -> None:
        """Put every geometry where it is at base pose and q, in the base's frame."""
        inverse = T_world_base.inverse()
        for i, (pose, _) in enumerate(self._fixed):
            self._model.geometryObjects[self._n_hand + i].placement = inverse * pose
        pin.updateGeometryPlacements(
            self.task.hand.pin_model, self._pin_data, self._model, self._data, np.asarray(q)
        )

    def _pair(self, a: int, b: int) -> DistancePair | MeshPair:
        """The query of two geometries, made when first needed."""
        if (a, b) not in self._queries:
            first, second = (self._model.geometryObjects[i].geometry for i in (a, b))
            self._queries[a, b] = (
                shape_pair(first, self.task.object.shape)
                if b == self._object
                else DistancePair(first, second)
            )
        return self._queries[a, b]


def shape_pair(geometry: Any, shape: Shape) -> DistancePair | MeshPair:
    """The distance query of a convex coal geometry (a) and a shape (b)."""
    if isinstance(shape, Mesh):
        return MeshPair(geometry, shape)
    return DistancePair(geometry, shape.coal_geometry())


def least_distance(shape: Shape, points: FloatArray) -> FloatArray:
    """Lower bounds (n,) of the signed distance (m) of points (n, 3): exact where that is cheap."""
    if not isinstance(shape, Mesh):
        return shape.signed_distance(points)
    lower, upper = shape.bounds
    outside = np.linalg.norm(np.maximum(np.maximum(lower - points, points - upper), 0.0), axis=1)
    field = shape.field()
    within = field.value(points) - field.error
    return np.where(outside > 0.0, outside, within)


def bounding_radius(geometry: Any) -> float:
    """Radius (m) of the ball about the geometry's origin that contains it."""
    geometry.computeLocalAABB()
    box = geometry.aabb_local
    return float(np.linalg.norm(np.maximum(np.abs(box.min_), np.abs(box.max_))))
