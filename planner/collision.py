"""``CollisionWorld``: all distances of a hand from object, table, obstacles and itself, at one q.

Pairs of convex geometries are measured in one call (``planner.geometry_pairs``), those of a mesh
one by one, as far as they can matter (``planner.mesh_pairs``).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Sequence
from itertools import combinations
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from planner.clearances import Clearance, NearPairs
from planner.errors import NotFoundError, TaskError
from planner.geometry_pairs import GeometryPairs
from planner.hand import Hand
from planner.kinematics import MovingHand
from planner.mesh_pairs import FEW, LEAST_LIMIT, MeshPairs
from planner.mesh_proximity import MeshPair
from planner.proximity import DistancePair, Proximity
from planner.shapes import Box, Mesh, Shape
from planner.spatial import SE3, FloatArray, IntArray
from planner.sweep import Sweep, hull_pairs
from planner.task import GraspTask

__all__ = [
    "TABLE_SIZE",
    "Clearance",
    "CollisionWorld",
    "NearPairs",
    "bounding_radius",
    "shape_pair",
]

OBJECT = "object"
TABLE = "table"

TABLE_SIZE = (2.0, 2.0, 0.1)
"""Full extents (m) of the table: wide enough for any hand, centred under the object."""


OVERLAP_TOL = 1e-5
"""Depth (m) to which the object may be inside table or obstacle: rounding, and coal's accuracy."""

MESH_LIMIT = 0.006
"""``CollisionWorld.near`` looks no further than this (m) from a mesh: what is near takes time."""

FAR = 0.03
"""``CollisionWorld.distances`` measures what is nearer to a mesh than this (m)."""


class CollisionWorld:
    """The true geometry of a task, ready to be asked at many configurations.

    Attributes:
        task: The task.
        surroundings: Names of all that is not the hand: object, table, obstacles.
        moving: The hand, for whoever asks to move about.
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
        self._fixed = [pose for _, pose, _ in fixed]
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
        self._names, self._pairs = tuple(names), [(names[a], names[b]) for a, b in pairs]
        self._model = model
        self._queries: dict[tuple[int, int], DistancePair | MeshPair] = {}
        self._outward = np.array([second in self.surroundings for _, second in self._pairs])
        arm = hand.arm.geometries if hand.arm is not None else frozenset()
        self._of_arm = np.array([a in arm or b in arm for a, b in self._pairs])
        self._between = _between_fingers(hand, pairs)
        self.moving = MovingHand(hand, hand.q_lower)
        self._on_object = np.array([b == OBJECT for _, b in self._pairs])
        self._all = np.ones(len(pairs), dtype=bool)
        self._first = np.array([a for a, _ in pairs])
        joint = [*(g.joint_id for g in hand.geometries), *(0 for _ in fixed)]
        self._joints = np.array([(joint[a], joint[b]) for a, b in pairs])
        self._geometries = GeometryPairs(hand.pin_model, model, pairs, n_hand)
        self._on_mesh = self._on_object & isinstance(task.object.shape, Mesh)
        self._mesh: MeshPairs | None = None
        hull: GeometryPairs | None = None
        if isinstance(task.object.shape, Mesh):
            self._mesh = MeshPairs([g.geometry for g in hand.geometries], task.object.shape)
            hull = hull_pairs(hand, task.object.shape)
        convex = np.flatnonzero(self._outward & ~self._on_mesh)
        self._sweep = Sweep(self._geometries, convex, self._mesh, hull)

    def distances(self, T_world_base: SE3, q: FloatArray) -> list[Clearance]:
        """Signed distance of every pair at base pose and q (nq,).

        Of a mesh and what is further from it than ``FAR``, it is only said to be that far.
        """
        self._place(T_world_base, q)
        values = self._distances(self._all, limit=FAR)
        return [self._clearance(k, d) for k, d in enumerate(values)]

    def closest(
        self, T_world_base: SE3, q: FloatArray, count: int, *, touching: Collection[str] = ()
    ) -> list[Clearance]:
        """The smallest signed distances at base pose and q (nq,), smallest first.

        Args:
            T_world_base: Base pose.
            q: Joints (nq,).
            count: How many; all that are negative come with them.
            touching: Geometries of the hand whose distance from the object is left out.
        """
        self._place(T_world_base, q)
        names = frozenset(touching)
        which = np.array([not (b == OBJECT and a in names) for a, b in self._pairs])
        values = self._distances(which, count=count)
        order = np.argsort(values, kind="stable")
        kept = order[: max(count, int((values < 0.0).sum()))]
        return [self._clearance(int(k), values[k]) for k in kept if values[k] < np.inf]

    def nearest(
        self, T_world_base: SE3, q: FloatArray, *, surroundings_only: bool = False
    ) -> Clearance:
        """The pair of smallest signed distance; of hand and surroundings only if asked."""
        self._place(T_world_base, q)
        return self._nearest(self._outward if surroundings_only else self._all)

    def touching(
        self,
        T_world_base: SE3,
        q: FloatArray,
        *,
        clearance: float = LEAST_LIMIT,
        surroundings_only: bool = False,
    ) -> Clearance | None:
        """The pair of smallest signed distance where that is below a clearance (m).

        Quicker than looking for the nearest where all are apart.

        Args:
            T_world_base: Base pose.
            q: Joints (nq,).
            clearance: m.
            surroundings_only: Whether only pairs of hand and surroundings matter.
        """
        self._place(T_world_base, q)
        found = self._nearest(self._outward if surroundings_only else self._all, clearance)
        return found if found.distance < clearance else None

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
        self._place(T_world_base, q, T_world_object)
        moving = self._outward | self._of_arm
        held = self._on_object & ~self._of_arm
        return self._nearest(moving if T_world_object is None else moving & ~held)

    def undercut_on_way(
        self, T_world_base: SE3, q: FloatArray, way: FloatArray, clearance: float
    ) -> Clearance | None:
        """A pair of hand and surroundings that comes nearer than a clearance on a straight way.

        Args:
            T_world_base: Base pose where the way begins.
            q: Joints (nq,).
            way: How the hand moves, without turning (3,), m, world.
            clearance: m.

        Returns:
            The pair with its distance where it first is too near, None if none is: without a gap,
            see ``planner.sweep``.
        """
        inverse = T_world_base.inverse()
        fixed = [inverse * pose for pose in self._fixed]
        found = self._sweep.undercut(q, fixed, inverse.rotation @ way, clearance)
        if found is None:
            return None
        pair, body, distance = found
        if pair is None:
            pair = int(np.flatnonzero(self._on_mesh & (self._first == body))[0])
        return self._clearance(pair, distance)

    def is_clear(self, T_world_base: SE3, q: FloatArray, *, around: float, between: float) -> bool:
        """Whether the hand keeps distances (m) from its surroundings and between its fingers.

        Of fingers only the last three joints' links count: those before are side by side always.
        """
        self._place(T_world_base, q)
        if self._nearest(self._outward, around).distance < around:
            return False
        fingers = self._nearest(self._between, between)
        return bool(fingers.distance >= between)

    def near(
        self, T_world_base: SE3, q: FloatArray, limit: float, among: IntArray | None = None
    ) -> NearPairs:
        """How hand and surroundings lie, and links of different fingers, that are near; base axes.

        Args:
            T_world_base: Base pose.
            q: Joints (nq,).
            limit: Pairs nearer than this (m) are looked at.
            among: Numbers of pairs that are looked at instead, but for those with a mesh.
        """
        self._place(T_world_base, q)
        convex = (self._outward | self._between) & ~self._on_mesh
        numbers, distances, rows = (
            self._geometries.near(convex, limit) if among is None else self._geometries.at(among)
        )
        if self._mesh is not None:
            on_mesh = np.flatnonzero(self._on_mesh)
            places, apart, more = self._mesh.near(self._first[on_mesh], min(limit, MESH_LIMIT))
            numbers = np.concatenate([numbers, on_mesh[places]])
            distances, rows = np.concatenate([distances, apart]), np.vstack([rows, more])
        return NearPairs(
            numbers=numbers,
            outward=self._outward[numbers],
            mesh=self._on_mesh[numbers],
            joints=self._joints[numbers],
            distances=distances,
            points_a=rows[:, :3],
            points_b=rows[:, 3:6],
            normals=rows[:, 6:],
        )

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
        poses = self._geometries.poses
        return self._pair(a, b).query(T_world_base * poses[a], T_world_base * poses[b])

    def _place(self, T_world_base: SE3, q: FloatArray, T_world_object: SE3 | None = None) -> None:
        """Put every geometry where it is at base pose and q, in the base's frame.

        Raises:
            TaskError: A number is not finite.
        """
        if not (np.isfinite(q).all() and np.isfinite(T_world_base.homogeneous).all()):
            raise TaskError("the base pose or q holds NaN or infinity; give finite numbers")
        inverse = T_world_base.inverse()
        poses = [inverse * pose for pose in self._fixed]
        if T_world_object is not None:
            poses[0] = inverse * T_world_object
        moved = self._geometries.place(q, poses)
        if self._mesh is not None:
            self._mesh.place(self._geometries.poses, poses[0], moved=moved)

    def _nearest(self, which: NDArray[np.bool_], limit: float = np.inf) -> Clearance:
        """The pair of smallest signed distance among those told, where they were last placed.

        With a limit (m), it is some pair at or above the limit where all are.
        """
        convex = which & ~self._on_mesh
        k, distance = self._geometries.nearest(convex) if convex.any() else (0, np.inf)
        if self._mesh is not None and self._is_mesh_below(which, limit):
            asked = np.flatnonzero(which & self._on_mesh)
            bodies = self._first[asked]
            found = self._mesh.nearest(bodies, min(distance, limit))
            if found is not None:
                k, distance = int(asked[bodies == found[0]][0]), found[1]
        return self._clearance(k, distance)

    def _is_mesh_below(self, which: NDArray[np.bool_], limit: float) -> bool:
        """Whether a pair of the mesh, among those told, may be nearer than a limit (m)."""
        on_mesh = which & self._on_mesh
        count = int(np.count_nonzero(on_mesh))
        if self._mesh is None or count == 0:
            return False
        return (
            limit == np.inf
            or count <= FEW
            or self._geometries.any_below(on_mesh, limit)
            or self._mesh.any_maybe_inside(self._first[on_mesh])
        )

    def _distances(
        self, which: NDArray[np.bool_], *, limit: float = 0.0, count: int = 0
    ) -> FloatArray:
        """Signed distance (m) of every pair, infinite where not asked.

        On a mesh, those are only bounded that are not below a limit (m) or, if a count is given,
        not of so many smallest.
        """
        values = np.full(len(self._pairs), np.inf)
        convex, on_mesh = which & ~self._on_mesh, np.flatnonzero(which & self._on_mesh)
        values[convex] = self._geometries.distances(convex)
        if self._mesh is not None and count:
            values[on_mesh] = self._mesh.smallest(self._first[on_mesh], values[convex], count)
        elif self._mesh is not None:
            values[on_mesh] = self._mesh.distances(self._first[on_mesh], limit)
        return values

    def _clearance(self, k: int, distance: float) -> Clearance:
        first, second = self._pairs[k]
        return Clearance(first=first, second=second, distance=float(distance))

    def _pair(self, a: int, b: int) -> DistancePair | MeshPair:
        """The query of two geometries, made when first needed."""
        if (a, b) not in self._queries:
            first, second = (self._model.geometryObjects[i].geometry for i in (a, b))
            self._queries[a, b] = (
                shape_pair(first, self.task.object.shape)
                if self._names[b] == OBJECT
                else DistancePair(first, second)
            )
        return self._queries[a, b]


def _between_fingers(hand: Hand, pairs: Sequence[tuple[int, int]]) -> NDArray[np.bool_]:
    """Which pairs (n_pairs,) are of links on the last three joints of two different fingers."""
    finger_of = [hand.finger_of_body.get(g.body, "") for g in hand.geometries]
    joints = np.array([g.joint_id for g in hand.geometries])
    outer = np.zeros(len(joints), dtype=bool)
    for name in hand.fingers:
        mine = np.array([of == name for of in finger_of])
        outer |= mine & np.isin(joints, np.unique(joints[mine])[-3:])
    n = len(joints)
    return np.array(
        [
            b < n and bool(outer[a]) and bool(outer[b]) and finger_of[a] != finger_of[b]
            for a, b in pairs
        ]
    )


def shape_pair(geometry: Any, shape: Shape) -> DistancePair | MeshPair:
    """The distance query of a convex coal geometry (a) and a shape (b)."""
    if isinstance(shape, Mesh):
        return MeshPair(geometry, shape)
    return DistancePair(geometry, shape.coal_geometry())


def bounding_radius(geometry: Any) -> float:
    """Radius (m) of the ball about the geometry's origin that contains it."""
    geometry.computeLocalAABB()
    box = geometry.aabb_local
    return float(np.linalg.norm(np.maximum(np.abs(box.min_), np.abs(box.max_))))
