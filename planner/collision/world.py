"""``CollisionWorld``: all distances of a hand from object, table, obstacles and itself, at one q.

Which pairs there are is in ``planner.collision.pair_table``. Pairs of convex geometries are
measured in one call (``planner.proximity.convex_pairs``), those of a mesh one by one, as far as
they can matter (``planner.proximity.mesh_pairs``).
"""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner.collision.pair_table import (
    OBJECT,
    TABLE,
    TABLE_SIZE,
    Clearance,
    NearPairs,
    PairTable,
    shape_pair,
)
from planner.collision.sweep import Sweep, hull_pairs
from planner.errors import NotFoundError, TaskError
from planner.kinematics.link_bounds import LinkBounds
from planner.kinematics.state import MovingHand
from planner.proximity.convex import DistancePair, Proximity
from planner.proximity.convex_pairs import GeometryPairs, PairQuery
from planner.proximity.mesh import MeshPair
from planner.proximity.mesh_pairs import FEW, LEAST_LIMIT, MeshPairs
from planner.shapes import Mesh
from planner.spatial import SE3, FloatArray, IntArray
from planner.task import GraspTask

__all__ = [
    "OBJECT",
    "TABLE",
    "TABLE_SIZE",
    "Clearance",
    "CollisionWorld",
    "NearPairs",
    "bounding_radius",
    "shape_pair",
]

MESH_LIMIT = 0.006
"""``CollisionWorld.near`` looks no further than this (m) from a mesh: what is near takes time."""

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
        self._table = table = PairTable.of(task)
        self.surroundings = table.surroundings
        self.moving = MovingHand(hand, hand.q_lower)
        self._all, self._numbers = (
            np.ones(len(table.pairs), dtype=bool),
            np.arange(len(table.pairs)),
        )
        self._queries: dict[tuple[int, int], DistancePair | MeshPair] = {}
        self._allowed: dict[frozenset[str], NDArray[np.bool_]] = {}
        self._geometries = GeometryPairs(hand.pin_model, table.model, table.pairs, table.n_hand)
        self._mesh: MeshPairs | None = None
        hull: GeometryPairs | None = None
        if isinstance(task.object.shape, Mesh):
            self._mesh = MeshPairs([g.geometry for g in hand.geometries], task.object.shape)
            hull = hull_pairs(hand, task.object.shape)
        shape = task.object.shape
        points = shape.hull_vertices if isinstance(shape, Mesh) else None
        self._bounds = LinkBounds(hand.pin_model, table.model, table.pairs, table.n_hand, points)
        self._sweep = Sweep(self._geometries, table, self._bounds, self._mesh, hull)
        self._around = np.flatnonzero(table.hand_environment_pairs)
        self._apart = np.flatnonzero(table.hand_environment_pairs | table.finger_pairs)
        self._forms: FloatArray | None = None  # where the forms of the bounds are
        self._base, self._held = np.full((4, 4), np.nan), False
        self._q, self._fixed, self._settled = hand.q_lower, list(table.fixed), False

    def distances(self, T_world_base: SE3, q: FloatArray) -> list[Clearance]:
        """Signed distance of every pair at base pose and q (nq,).

        Of a mesh and what is further from it than ``FAR``, it is only said to be that far.
        """
        self._place(T_world_base, q)
        self._settle()
        values = self._distances(self._all, limit=FAR)
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
        self._place(T_world_base, q)
        values = self._smallest(~self._contact_pairs(frozenset(may_touch)), count)
        order = np.argsort(values, kind="stable")
        kept = order[: max(count, int((values < 0.0).sum()))]
        return [self._clearance(int(k), values[k]) for k in kept if values[k] < np.inf]

    def nearest(
        self, T_world_base: SE3, q: FloatArray, *, surroundings_only: bool = False
    ) -> Clearance:
        """The pair of smallest signed distance; of hand and surroundings only if asked."""
        self._place(T_world_base, q)
        return self._nearest(self._table.hand_environment_pairs if surroundings_only else self._all)

    def nearest_below(
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
        which = self._table.hand_environment_pairs if surroundings_only else self._all
        if self._bounds.pays:
            asked = self._around if surroundings_only else self._numbers
            near = asked[self._least(asked, clearance) < clearance]
            if len(near) == 0:
                return None
            if np.count_nonzero(self._table.on_mesh[near]) <= ONE_BY_ONE:
                found = self._nearest_by_bounds(near, clearance)
                return found if found.distance < clearance else None
        if not self._is_any_below(which, clearance):
            return None
        found = self._nearest(which, clearance)
        return found if found.distance < clearance else None

    def maybe_touching(self, T_world_base: SE3, path: FloatArray) -> IntArray:
        """Which configurations (k,) of a path (m, nq) may touch something; not all of them do.

        Quicker than ``nearest_below`` of each where kernels are compiled; else it is all of them.
        """
        if not self._bounds.pays:
            return np.arange(len(path))
        self._place(T_world_base, path[0])
        forms = self._bounds.place(path, self._fixed)
        bounds = self._bounds.at(forms, self._numbers, np.full(len(path), LEAST_LIMIT))
        return np.flatnonzero((bounds < LEAST_LIMIT).any(axis=1))

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
        moving = self._table.hand_environment_pairs | self._table.of_arm
        held = self._table.on_object & ~self._table.of_arm
        return self._nearest(moving if T_world_object is None else moving & ~held)

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
            see ``planner.collision.sweep``.
        """
        self._place(T_world_base, q)
        forms = self._placed_forms() if self._bounds.pays else None
        way = T_world_base.rotation.T @ way
        found = self._sweep.violation(q, self._fixed, forms, way, clearance)
        self._settled = False  # the sweep has moved them
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
        self._place(T_world_base, q)
        table = self._table
        if self._bounds.pays:
            outer = table.hand_environment_pairs[self._apart]
            wanted = np.where(outer, environment, fingers)
            near = self._least(self._apart, max(environment, fingers)) < wanted
            return not near.any() or self._keeps(self._apart[near], wanted[near], environment)
        around = self._nearest(table.hand_environment_pairs, environment)
        if around.distance < environment:
            return False
        return bool(self._nearest(table.finger_pairs, fingers).distance >= fingers)

    def _keeps(self, numbers: IntArray, wanted: FloatArray, from_mesh: float) -> bool:
        """Whether pairs, by their numbers (k,), are as far apart (m) as wanted (k,), measured."""
        self._settle()
        on_mesh = self._table.on_mesh[numbers]
        convex = numbers[~on_mesh]
        if (self._geometries.measure(convex) < wanted[~on_mesh]).any():
            return False
        return not on_mesh.any() or self._nearest_on_mesh(numbers[on_mesh], from_mesh) is None

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
        self._place(T_world_base, q)
        table = self._table
        wanted = (table.hand_environment_pairs | table.finger_pairs) & ~self._contact_pairs(
            frozenset(may_touch)
        )
        self._settle()
        numbers, distances, rows = (
            self._near_convex(wanted & ~table.on_mesh, limit)
            if among is None
            else self._geometries.at(among)
        )
        if self._mesh is not None and meshes:
            on_mesh = np.flatnonzero(wanted & table.on_mesh)
            places, apart, more = self._mesh.near(table.first[on_mesh], min(limit, MESH_LIMIT))
            numbers = np.concatenate([numbers, on_mesh[places]])
            distances, rows = np.concatenate([distances, apart]), np.vstack([rows, more])
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

    def _near_convex(self, which: NDArray[np.bool_], limit: float) -> PairQuery:
        if not self._bounds.pays:
            return self._geometries.near(which, limit)
        asked = np.flatnonzero(which)
        return self._geometries.near(which, limit, asked[self._least(asked, limit) < limit])

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
        self._place(T_world_base, q)
        self._settle()
        a, b = self._table.names.index(first), self._table.names.index(second)
        poses = self._geometries.poses
        return self._pair(a, b).query(T_world_base * poses[a], T_world_base * poses[b])

    def _place(self, T_world_base: SE3, q: FloatArray, T_world_object: SE3 | None = None) -> None:
        """Say where everything is at base pose and q: the base's frame counts.

        Raises:
            TaskError: A number is not finite.
        """
        base, held = T_world_base.homogeneous, T_world_object is not None
        same = not (held or self._held) and (base == self._base).all() and (q == self._q).all()
        if same:
            return
        if not math.isfinite(float(q.sum()) + float(base.sum())):
            raise TaskError("the base pose or q holds NaN or infinity; give finite numbers")
        inverse = T_world_base.inverse()
        self._q, self._base, self._held = q.copy(), base, held
        self._fixed = [inverse * pose for pose in self._table.fixed]
        if T_world_object is not None:
            self._fixed[0] = inverse * T_world_object
        self._forms, self._settled = None, False

    def _settle(self) -> None:
        """Put every geometry there, before coal is asked."""
        if not self._settled:
            self._geometries.place(self._q, self._fixed)
            if self._mesh is not None:
                self._mesh.place(self._geometries.poses, self._fixed[0])
            self._settled = True

    def _placed_forms(self) -> FloatArray:
        """Where the forms of the bounds are (1, n, 3, 4)."""
        if self._forms is None:
            self._forms = self._bounds.place(self._q[None], self._fixed)
        return self._forms

    def _least(self, asked: IntArray, limit: float) -> FloatArray:
        """Lower bounds of the distances (m) of pairs by their numbers (k,), rough from a limit."""
        return np.asarray(self._bounds.at(self._placed_forms(), asked, np.array([limit]))[0])

    def _nearest(self, which: NDArray[np.bool_], limit: float = np.inf) -> Clearance:
        """The pair of smallest signed distance among those told, where they were last placed.

        With a limit (m), it is some pair at or above the limit where all are.
        """
        if self._bounds.pays:
            return self._nearest_by_bounds(np.flatnonzero(which), limit)
        self._settle()
        convex = which & ~self._table.on_mesh
        k, distance = self._geometries.nearest(convex) if convex.any() else (0, np.inf)
        if self._mesh is not None and self._is_mesh_below(which, limit):
            found = self._nearest_on_mesh(np.flatnonzero(which), min(distance, limit))
            k, distance = (k, distance) if found is None else found
        return self._clearance(k, distance)

    def _nearest_by_bounds(self, asked: IntArray, limit: float) -> Clearance:
        """The same: pairs in the order of their bounds, until no other can be nearer."""
        bounds = self._least(asked, limit)
        order = bounds.argsort(kind="stable")
        order = order[bounds[order] < limit]
        if len(order) == 0:
            return self._clearance(int(asked[0]) if len(asked) > 0 else 0, limit)
        self._settle()
        numbers, k, least = asked[order], int(asked[order[0]]), limit
        convex = ~self._table.on_mesh[numbers]
        for number, bound in zip(numbers[convex], bounds[order][convex], strict=True):
            if bound >= max(least, 0.0):  # of a depth there is no bound
                break
            distance = float(self._geometries.measure(np.array([number]))[0])
            if distance < least or (distance == least and number < k):
                k, least = int(number), distance
        on_mesh = numbers[self._table.on_mesh[numbers]]
        if self._mesh is not None and len(on_mesh) > 0:
            found = self._nearest_on_mesh(np.sort(on_mesh), least)
            k, least = (k, least) if found is None else found
        return self._clearance(k, least)

    def _nearest_on_mesh(self, asked: IntArray, limit: float) -> tuple[int, float] | None:
        """Of pairs by their numbers (k,), that with the mesh of least distance below a limit."""
        asked = asked[self._table.on_mesh[asked]]
        bodies = self._table.first[asked]
        found = self._mesh.nearest(bodies, limit) if self._mesh is not None else None
        return None if found is None else (int(asked[bodies == found[0]][0]), found[1])

    def _is_any_below(self, which: NDArray[np.bool_], limit: float) -> bool:
        """Whether a pair among those told may be nearer than a limit (m), in one look at all."""
        self._settle()
        if self._geometries.any_below(which, limit):
            return True
        on_mesh = which & self._table.on_mesh
        if self._mesh is None or not on_mesh.any():
            return False
        return self._mesh.any_maybe_inside(self._table.first[on_mesh])

    def _is_mesh_below(self, which: NDArray[np.bool_], limit: float) -> bool:
        """Whether a pair of the mesh, among those told, may be nearer than a limit (m)."""
        on_mesh = which & self._table.on_mesh
        count = int(np.count_nonzero(on_mesh))
        if self._mesh is None or count == 0:
            return False
        return (
            limit == np.inf
            or count <= FEW
            or self._geometries.any_below(on_mesh, limit)
            or self._mesh.any_maybe_inside(self._table.first[on_mesh])
        )

    def _smallest(self, which: NDArray[np.bool_], count: int) -> FloatArray:
        """Signed distances (m) of the pairs told, infinite where they are not of the smallest few.

        All that are negative are told.
        """
        self._settle()
        if not self._bounds.pays:
            return self._distances(which, count=count)
        table = self._table
        values = np.full(len(table.pairs), np.inf)
        asked = np.flatnonzero(which & ~table.on_mesh)
        bounds = self._least(asked, np.inf)
        order, done = np.argsort(bounds, kind="stable"), 0
        while done < len(order):
            least = np.partition(values, count - 1)[count - 1] if count <= done else np.inf
            if bounds[order[done]] >= max(float(least), 0.0):
                break
            some = asked[order[done : done + max(count, 1)]]
            values[some] = self._geometries.measure(some)
            done += len(some)
        if self._mesh is not None:
            on_mesh = np.flatnonzero(which & table.on_mesh)
            values[on_mesh] = self._mesh.smallest(table.first[on_mesh], values[asked], count)
        return values

    def _distances(
        self, which: NDArray[np.bool_], *, limit: float = 0.0, count: int = 0
    ) -> FloatArray:
        """Signed distance (m) of every pair, infinite where not asked.

        On a mesh, those are only bounded that are not below a limit (m) or, if a count is given,
        not of so many smallest.
        """
        table = self._table
        values = np.full(len(table.pairs), np.inf)
        convex, on_mesh = which & ~table.on_mesh, np.flatnonzero(which & table.on_mesh)
        values[convex] = self._geometries.distances(convex)
        if self._mesh is not None and count:
            values[on_mesh] = self._mesh.smallest(table.first[on_mesh], values[convex], count)
        elif self._mesh is not None:
            values[on_mesh] = self._mesh.distances(table.first[on_mesh], limit)
        return values

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


def bounding_radius(geometry: Any) -> float:
    """Radius (m) of the ball about the geometry's origin that contains it."""
    geometry.computeLocalAABB()
    box = geometry.aabb_local
    return float(np.linalg.norm(np.maximum(np.abs(box.min_), np.abs(box.max_))))
