"""``CollisionWorld``: all distances of a hand from object, table, obstacles and itself, at one q.

Which pairs there are is in ``planner.collision.pair_table``, how they are measured in
``planner.collision.placed_pairs``.
"""

from __future__ import annotations

import copy
from collections.abc import Collection
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planner.collision.pair_table import (
    OBJECT,
    TABLE,
    TABLE_SIZE,
    Clearance,
    NearPairs,
    shape_pair,
)
from planner.collision.placed_pairs import PlacedPairs, Sweep, hull_pairs
from planner.errors import NotFoundError
from planner.kinematics import MovingHand
from planner.numerics.kernels import kernels_are_compiled
from planner.shapes import Mesh
from planner.shapes.convex_pairs import LEAST_LIMIT, DistancePair, Proximity
from planner.spatial import SE3, FloatArray, IntArray
from planner.task import GraspTask

if TYPE_CHECKING:
    from planner.collision.mesh_distance import MeshPair

__all__ = [
    "OBJECT",
    "TABLE",
    "TABLE_SIZE",
    "Clearance",
    "CollisionWorld",
    "NearPairs",
    "shape_pair",
]

ONE_BY_ONE = 8
"""Pairs with a mesh up to which asking for each takes less time than one look at all: 0.2 ms."""

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
        self._pairs = pairs = PlacedPairs(task)
        self._table = table = pairs.table
        self.surroundings = table.surroundings
        self.moving = MovingHand(hand, hand.q_lower)
        self._numbers = np.arange(len(table.pairs))
        self._all = np.ones(len(table.pairs), dtype=bool)
        self._queries: dict[tuple[int, int], DistancePair | MeshPair] = {}
        self._allowed: dict[frozenset[str], NDArray[np.bool_]] = {}
        self._moving: dict[frozenset[str], NDArray[np.bool_]] = {}
        shape = task.object.shape
        hull = hull_pairs(hand, shape) if isinstance(shape, Mesh) else None
        self._sweep = Sweep(pairs, hull)
        self._around = np.flatnonzero(table.hand_environment_pairs)
        self._apart = np.flatnonzero(table.hand_environment_pairs | table.finger_pairs)

    def of(self, task: GraspTask) -> CollisionWorld:
        """The same geometry for other fingers, or another place of the base, of the same world.

        Both are asked in turns; hand, object, its pose and the surroundings are the same.
        """
        other = copy.copy(self)
        other.task = task
        return other

    def distances(self, T_world_base: SE3, q: FloatArray) -> list[Clearance]:
        """Signed distance of every pair at base pose and q (nq,).

        Of a mesh and what is further from it than ``FAR``, it is only said to be that far.
        """
        self._pairs.place(T_world_base, q)
        self._pairs.settle()
        values = self._pairs.distances(self._all, limit=FAR)
        return [self._clearance(k, d) for k, d in enumerate(values)]

    def closest(
        self, T_world_base: SE3, q: FloatArray, count: int, *, may_touch: Collection[str] = ()
    ) -> list[Clearance]:
        """The smallest signed distances at base pose and q (nq,), smallest first.

        Args:
            T_world_base: Base pose.
            q: Joints (nq,).
            count: How many; all that are negative come with them.
            may_touch: Geometries of the hand whose distance from the object is left out.
        """
        self._pairs.place(T_world_base, q)
        values = self._pairs.smallest(~self._contact_pairs(frozenset(may_touch)), count)
        order = np.argsort(values, kind="stable")
        kept = order[: max(count, int((values < 0.0).sum()))]
        return [self._clearance(int(k), values[k]) for k in kept if values[k] < np.inf]

    def nearest(
        self, T_world_base: SE3, q: FloatArray, *, surroundings_only: bool = False
    ) -> Clearance:
        """The pair of smallest signed distance; of hand and surroundings only if asked."""
        self._pairs.place(T_world_base, q)
        return self._nearest(self._table.hand_environment_pairs if surroundings_only else self._all)

    def nearest_below(
        self,
        T_world_base: SE3,
        q: FloatArray,
        *,
        clearance: float = LEAST_LIMIT,
        surroundings_only: bool = False,
        may_touch: Collection[str] = (),
    ) -> Clearance | None:
        """The pair of smallest signed distance where that is below a clearance (m).

        Quicker than looking for the nearest where all are apart.

        Args:
            T_world_base: Base pose.
            q: Joints (nq,).
            clearance: m.
            surroundings_only: Whether only pairs of hand and surroundings matter.
            may_touch: Geometries of the hand whose distance from the object is left out.
        """
        self._pairs.place(T_world_base, q)
        which = self._table.hand_environment_pairs if surroundings_only else self._all
        if may_touch:
            which = which & ~self._contact_pairs(frozenset(may_touch))
        if kernels_are_compiled():
            asked = self._around if surroundings_only else self._numbers
            asked = asked[which[asked]]
            near = asked[self._pairs.lower_bounds(asked, clearance) < clearance]
            if len(near) == 0:
                return None
            if np.count_nonzero(self._table.on_mesh[near]) <= ONE_BY_ONE:
                found = self._clearance(*self._pairs.nearest_by_bounds(near, clearance))
                return found if found.distance < clearance else None
        if not self._pairs.is_any_below(which, clearance):
            return None
        found = self._nearest(which, clearance)
        return found if found.distance < clearance else None

    def maybe_touching(self, T_world_base: SE3, path: FloatArray) -> IntArray:
        """Which configurations (k,) of a path (m, nq) may touch something; not all of them do.

        Quicker than ``nearest_below`` of each where kernels are compiled; else it is all of them.
        """
        if not kernels_are_compiled():
            return np.arange(len(path))
        self._pairs.place(T_world_base, path[0])
        bounds = self._pairs.bounds
        forms = bounds.place(path, self._pairs.fixed)
        least = bounds.at(forms, self._numbers, np.full(len(path), LEAST_LIMIT))
        return np.flatnonzero((least < LEAST_LIMIT).any(axis=1))

    def nearest_on_arm(
        self, T_world_base: SE3, q: FloatArray, *, T_world_object: SE3 | None = None
    ) -> Clearance:
        """The pair of smallest signed distance among those that change when the arm moves.

        Arm and hand against the surroundings, and the arm against itself and the hand. Two hands
        that hold the object move together; else each is looked at against the other.

        Args:
            T_world_base: Pose of the arm's root.
            q: Joints (nq,).
            T_world_object: Where the object is if the hand holds it; only the arm's distance from
                it counts then.
        """
        self._pairs.place(T_world_base, q, T_world_object)
        moving = self._table.hand_environment_pairs | self._table.of_arm
        held = self._table.on_object & ~self._table.of_arm
        if T_world_object is None:
            moving = moving | self._table.between_hands
        return self._nearest(moving if T_world_object is None else moving & ~held)

    def nearest_of(self, T_world_base: SE3, q: FloatArray, moving: frozenset[str]) -> Clearance:
        """The pair of smallest signed distance of which one of these geometries and another is.

        Args:
            T_world_base: Base pose.
            q: Joints (nq,).
            moving: Names of geometries, such as those of one hand of two.
        """
        if moving not in self._moving:
            named = self._table.named
            self._moving[moving] = np.array([(a in moving) != (b in moving) for a, b in named])
        self._pairs.place(T_world_base, q)
        return self._nearest(self._moving[moving])

    def between_fingers(self, T_world_base: SE3, q: FloatArray, limit: float) -> Clearance | None:
        """The pair of two different fingers that is nearest, where that is below a limit (m)."""
        self._pairs.place(T_world_base, q)
        found = self._nearest(self._table.between_fingers, limit)
        return found if found.distance < limit else None

    def swept_clearance_violation(
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
            see ``planner.collision.placed_pairs``.
        """
        self._pairs.place(T_world_base, q)
        forms = self._pairs.forms() if kernels_are_compiled() else None
        way = T_world_base.rotation.T @ way
        found = self._sweep.violation(q, self._pairs.fixed, forms, way, clearance)
        self._pairs.unsettle()  # the sweep has moved them
        if found is None:
            return None
        pair, body, distance = found
        if pair is None:
            pair = int(np.flatnonzero(self._table.on_mesh & (self._table.first == body))[0])
        return self._clearance(pair, distance)

    def is_clear(
        self, T_world_base: SE3, q: FloatArray, *, environment: float, fingers: float
    ) -> bool:
        """Whether the hand keeps distances (m) from its surroundings and between its fingers.

        Of fingers only the last three joints' links count: those before are side by side always.
        """
        pairs, table = self._pairs, self._table
        pairs.place(T_world_base, q)
        if kernels_are_compiled():
            outer = table.hand_environment_pairs[self._apart]
            wanted = np.where(outer, environment, fingers)
            near = pairs.lower_bounds(self._apart, max(environment, fingers)) < wanted
            return not near.any() or pairs.keep_apart(self._apart[near], wanted[near], environment)
        around = self._nearest(table.hand_environment_pairs, environment)
        if around.distance < environment:
            return False
        return bool(self._nearest(table.finger_pairs, fingers).distance >= fingers)

    def near(
        self,
        T_world_base: SE3,
        q: FloatArray,
        limit: float,
        among: IntArray | None = None,
        *,
        may_touch: Collection[str] = (),
        meshes: bool = True,
    ) -> NearPairs:
        """How hand and surroundings lie, and links of different fingers, that are near; base axes.

        Args:
            T_world_base: Base pose.
            q: Joints (nq,).
            limit: Pairs nearer than this (m) are looked at.
            among: Numbers of pairs that are looked at instead, but for those with a mesh.
            may_touch: Geometries of the hand whose distance from the object is left out.
            meshes: Whether pairs with a mesh are looked at, which takes most of the time.
        """
        table = self._table
        self._pairs.place(T_world_base, q)
        wanted = (table.hand_environment_pairs | table.finger_pairs) & ~self._contact_pairs(
            frozenset(may_touch)
        )
        numbers, distances, rows = self._pairs.near(wanted, limit, among, meshes)
        return NearPairs(
            numbers=numbers,
            hand_environment=table.hand_environment_pairs[numbers],
            mesh=table.on_mesh[numbers],
            joints=table.joints[numbers],
            distances=distances,
            points_a=rows[:, :3],
            points_b=rows[:, 3:6],
            normals=rows[:, 6:],
        )

    def _contact_pairs(self, names: frozenset[str]) -> NDArray[np.bool_]:
        """Which pairs are of the object and a geometry that may touch it."""
        if names not in self._allowed:
            named = self._table.named
            self._allowed[names] = np.array([b == OBJECT and a in names for a, b in named])
        return self._allowed[names]

    def proximity(self, T_world_base: SE3, q: FloatArray, first: str, second: str) -> Proximity:
        """Signed distance, nearest points and normal (world) of any two geometries by name.

        Raises:
            NotFoundError: No geometry has that name.
        """
        for name in (first, second):
            if name not in self._table.names:
                raise NotFoundError("geometry", name, self._table.names)
        self._pairs.place(T_world_base, q)
        self._pairs.settle()
        a, b = self._table.names.index(first), self._table.names.index(second)
        poses = self._pairs.geometries.poses
        return self._pair(a, b).query(T_world_base * poses[a], T_world_base * poses[b])

    def _nearest(self, which: NDArray[np.bool_], limit: float = np.inf) -> Clearance:
        return self._clearance(*self._pairs.nearest(which, limit))

    def _clearance(self, k: int, distance: float) -> Clearance:
        first, second = self._table.named[k]
        return Clearance(first=first, second=second, distance=float(distance))

    def _pair(self, a: int, b: int) -> DistancePair | MeshPair:
        """The query of two geometries, made when first needed."""
        if (a, b) not in self._queries:
            first, second = (self._table.model.geometryObjects[i].geometry for i in (a, b))
            self._queries[a, b] = (
                shape_pair(first, self.task.object.shape)
                if self._table.names[b] == OBJECT
                else DistancePair(first, second)
            )
        return self._queries[a, b]
