"""``PlacedPairs``: the pairs of a task where its hand is now, and how near they are by number.

``CollisionWorld`` asks it and gives names to the answers. Bounds come first where they pay, then
convex pairs, measured in one call, and last those of a mesh, as far as they can matter.

``Sweep`` answers for a hand that moves straight, without turning. The distance of two convex bodies
is a convex function of such a way: its value and its slope at both ends bound it from below. Most
bodies are proven clear by that; of a mesh the convex hull is taken, which is not farther than the
mesh. The others are followed without a gap: from a place with distance d, a body may move by d less
the clearance.
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from planner.collision.pair_table import PairTable
from planner.errors import TaskError
from planner.hands.hand import Hand
from planner.numerics.kernels import kernels_are_compiled
from planner.shapes import Mesh
from planner.shapes.convex_pairs import FEW, GeometryPairs, PairQuery
from planner.spatial import SE3, FloatArray, IntArray
from planner.task import GraspTask

if TYPE_CHECKING:
    from planner.collision.link_bounds import LinkBounds
    from planner.collision.mesh_pairs import MeshPairs

MESH_LIMIT = 0.006
"""``PlacedPairs.near`` looks no further than this (m) from a mesh; a wider search takes longer."""


class PlacedPairs:
    """Pairs of one task, placed again and again.

    Attributes:
        table: Which pairs there are.
        geometries: Queries of the convex ones.
        mesh: Queries of those with an object that is a mesh; None if it is none.
        fixed: Poses of what stands around, base axes, the object first.
    """

    def __init__(self, task: GraspTask) -> None:
        """Collect them; nothing is placed.

        Raises:
            TaskError: As ``PairTable.of``.
        """
        hand, shape = task.hand, task.object.shape
        self.table = table = PairTable.of(task)
        self.geometries = GeometryPairs(hand.pin_model, table.model, table.pairs, table.n_hand)
        self.mesh: MeshPairs | None = None
        if isinstance(shape, Mesh):
            from planner.collision.mesh_pairs import MeshPairs  # here: for meshes alone

            self.mesh = MeshPairs([g.geometry for g in hand.geometries], shape)
        self._task = task
        self.fixed: list[SE3] = list(table.fixed)
        self._forms: FloatArray | None = None  # where the forms of the bounds are
        self._base, self._held = np.full((4, 4), np.nan), False
        self._q, self._settled = hand.q_lower, False

    @cached_property
    def bounds(self) -> LinkBounds:
        """Lower bounds of all distances; they pay where kernels are compiled."""
        from planner.collision.link_bounds import LinkBounds  # here: a single plan compiles nothing

        table, shape = self.table, self._task.object.shape
        points = shape.hull_vertices if isinstance(shape, Mesh) else None
        model = self._task.hand.pin_model
        return LinkBounds(model, table.model, table.pairs, table.n_hand, points)

    def place(self, T_world_base: SE3, q: FloatArray, T_world_object: SE3 | None = None) -> None:
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
        self.fixed = [inverse * pose for pose in self.table.fixed]
        if T_world_object is not None:
            self.fixed[0] = inverse * T_world_object
        self._forms, self._settled = None, False

    def settle(self) -> None:
        """Put every geometry there, before coal is asked."""
        if not self._settled:
            self.geometries.place(self._q, self.fixed)
            if self.mesh is not None:
                self.mesh.place(self.geometries.poses, self.fixed[0])
            self._settled = True

    def unsettle(self) -> None:
        """Say that somebody else has moved the geometries meanwhile."""
        self._settled = False

    def forms(self) -> FloatArray:
        """Where the forms of the bounds are (1, n, 3, 4)."""
        if self._forms is None:
            self._forms = self.bounds.place(self._q[None], self.fixed)
        return self._forms

    def lower_bounds(self, asked: IntArray, limit: float) -> FloatArray:
        """Lower bounds of the distances (m) of pairs by their numbers (k,), rough from a limit."""
        return np.asarray(self.bounds.at(self.forms(), asked, np.array([limit]))[0])

    def nearest(self, which: NDArray[np.bool_], limit: float = np.inf) -> tuple[int, float]:
        """The pair of smallest signed distance among those told, where they were last placed.

        With a limit (m), it is some pair at or above the limit where all are.
        """
        if kernels_are_compiled():
            return self.nearest_by_bounds(np.flatnonzero(which), limit)
        self.settle()
        convex = which & ~self.table.on_mesh
        k, distance = self.geometries.nearest(convex) if convex.any() else (0, np.inf)
        if self.mesh is not None and self._is_mesh_below(which, limit):
            found = self.nearest_on_mesh(np.flatnonzero(which), min(distance, limit))
            k, distance = (k, distance) if found is None else found
        return k, distance

    def nearest_by_bounds(self, asked: IntArray, limit: float) -> tuple[int, float]:
        """The same: pairs in the order of their bounds, until no other can be nearer."""
        bounds = self.lower_bounds(asked, limit)
        order = bounds.argsort(kind="stable")
        order = order[bounds[order] < limit]
        if len(order) == 0:
            return (int(asked[0]) if len(asked) > 0 else 0), limit
        self.settle()
        numbers, k, least = asked[order], int(asked[order[0]]), limit
        convex = ~self.table.on_mesh[numbers]
        for number, bound in zip(numbers[convex], bounds[order][convex], strict=True):
            if bound >= max(least, 0.0):  # of a depth there is no bound
                break
            distance = float(self.geometries.measure(np.array([number]))[0])
            if distance < least or (distance == least and number < k):
                k, least = int(number), distance
        on_mesh = numbers[self.table.on_mesh[numbers]]
        if self.mesh is not None and len(on_mesh) > 0:
            found = self.nearest_on_mesh(np.sort(on_mesh), least)
            k, least = (k, least) if found is None else found
        return k, least

    def nearest_on_mesh(self, asked: IntArray, limit: float) -> tuple[int, float] | None:
        """Of pairs by their numbers (k,), that with the mesh of least distance below a limit."""
        asked = asked[self.table.on_mesh[asked]]
        bodies = self.table.first[asked]
        found = self.mesh.nearest(bodies, limit) if self.mesh is not None else None
        return None if found is None else (int(asked[bodies == found[0]][0]), found[1])

    def is_any_below(self, which: NDArray[np.bool_], limit: float) -> bool:
        """Whether a pair among those told may be nearer than a limit (m), in one look at all."""
        self.settle()
        if self.geometries.any_below(which, limit):
            return True
        on_mesh = which & self.table.on_mesh
        if self.mesh is None or not on_mesh.any():
            return False
        return self.mesh.any_maybe_inside(self.table.first[on_mesh])

    def _is_mesh_below(self, which: NDArray[np.bool_], limit: float) -> bool:
        """Whether a pair of the mesh, among those told, may be nearer than a limit (m)."""
        on_mesh = which & self.table.on_mesh
        count = int(np.count_nonzero(on_mesh))
        if self.mesh is None or count == 0:
            return False
        return (
            limit == np.inf
            or count <= FEW
            or self.geometries.any_below(on_mesh, limit)
            or self.mesh.any_maybe_inside(self.table.first[on_mesh])
        )

    def smallest(self, which: NDArray[np.bool_], count: int) -> FloatArray:
        """Signed distances (m) of the pairs told, infinite where they are not of the smallest few.

        All that are negative are told.
        """
        self.settle()
        if not kernels_are_compiled():
            return self.distances(which, count=count)
        table = self.table
        values = np.full(len(table.pairs), np.inf)
        asked = np.flatnonzero(which & ~table.on_mesh)
        bounds = self.lower_bounds(asked, np.inf)
        order, done = np.argsort(bounds, kind="stable"), 0
        while done < len(order):
            least = np.partition(values, count - 1)[count - 1] if count <= done else np.inf
            if bounds[order[done]] >= max(float(least), 0.0):
                break
            some = asked[order[done : done + max(count, 1)]]
            values[some] = self.geometries.measure(some)
            done += len(some)
        if self.mesh is not None:
            on_mesh = np.flatnonzero(which & table.on_mesh)
            values[on_mesh] = self.mesh.smallest(table.first[on_mesh], values[asked], count)
        return values

    def distances(
        self, which: NDArray[np.bool_], *, limit: float = 0.0, count: int = 0
    ) -> FloatArray:
        """Signed distance (m) of every pair, infinite where not asked.

        On a mesh, those are only bounded that are not below a limit (m) or, if a count is given,
        not of so many smallest.
        """
        table = self.table
        values = np.full(len(table.pairs), np.inf)
        convex, on_mesh = which & ~table.on_mesh, np.flatnonzero(which & table.on_mesh)
        values[convex] = self.geometries.distances(convex)
        if self.mesh is not None and count:
            values[on_mesh] = self.mesh.smallest(table.first[on_mesh], values[convex], count)
        elif self.mesh is not None:
            values[on_mesh] = self.mesh.distances(table.first[on_mesh], limit)
        return values

    def keep_apart(self, numbers: IntArray, wanted: FloatArray, from_mesh: float) -> bool:
        """Whether pairs, by their numbers (k,), are as far apart (m) as wanted (k,), measured."""
        self.settle()
        on_mesh = self.table.on_mesh[numbers]
        convex = numbers[~on_mesh]
        if (self.geometries.measure(convex) < wanted[~on_mesh]).any():
            return False
        return not on_mesh.any() or self.nearest_on_mesh(numbers[on_mesh], from_mesh) is None

    def near(
        self, which: NDArray[np.bool_], limit: float, among: IntArray | None, on_mesh: bool
    ) -> PairQuery:
        """How pairs lie that are near: numbers (k,), signed distances (k,), rows (k, 9).

        Args:
            which: Pairs (n_pairs,) to look at.
            limit: Pairs nearer than this (m) are told.
            among: Numbers of convex pairs that are told instead.
            on_mesh: Whether pairs with a mesh are looked at; up to ``MESH_LIMIT``.
        """
        self.settle()
        convex = which & ~self.table.on_mesh
        numbers, distances, rows = (
            self._near_convex(convex, limit) if among is None else self.geometries.at(among)
        )
        if self.mesh is not None and on_mesh:
            asked = np.flatnonzero(which & self.table.on_mesh)
            places, apart, more = self.mesh.near(self.table.first[asked], min(limit, MESH_LIMIT))
            numbers = np.concatenate([numbers, asked[places]])
            distances, rows = np.concatenate([distances, apart]), np.vstack([rows, more])
        return numbers, distances, rows

    def _near_convex(self, which: NDArray[np.bool_], limit: float) -> PairQuery:
        if not kernels_are_compiled():
            return self.geometries.near(which, limit)
        asked = np.flatnonzero(which)
        return self.geometries.near(which, limit, asked[self.lower_bounds(asked, limit) < limit])


NORMAL_ERROR = 1e-4
"""Error of coal's normals (rad)."""

LEAST_STEP = 5e-4
"""Shortest step (m): less than the clearance that is asked for, so that nothing is jumped over."""

LONGEST_STEP = 0.02
"""Longest step (m) beside a mesh: whether something is nearer than that is soon seen."""


def hull_pairs(hand: Hand, mesh: Mesh) -> GeometryPairs:
    """Every geometry of a hand, in order, and the convex hull of a mesh."""
    model = pin.GeometryModel()
    for g in hand.geometries:
        body = pin.GeometryObject(g.name, g.joint_id, g.T_joint_geometry, g.geometry)
        model.addGeometryObject(body)
    model.addGeometryObject(pin.GeometryObject("hull", 0, SE3.Identity(), mesh.coal_hull))
    n = len(hand.geometries)
    return GeometryPairs(hand.pin_model, model, [(i, n) for i in range(n)], n)


class Sweep:
    """The geometries of a hand at q against what stands around, which moves instead of the hand."""

    def __init__(self, placed: PlacedPairs, hull: GeometryPairs | None) -> None:
        """Keep the queries.

        Args:
            placed: All pairs of the world.
            hull: The hand and the convex hull of the object, if that is a mesh.
        """
        self._placed, self._pairs, table = placed, placed.geometries, placed.table
        self._mesh, self._hull = placed.mesh, hull
        self._chosen = table.hand_environment_pairs & ~table.on_mesh
        self._convex = np.flatnonzero(self._chosen)
        self._with_mesh, self._first = np.flatnonzero(table.on_mesh), table.first

    def violation(
        self,
        q: FloatArray,
        fixed: list[SE3],
        forms: FloatArray | None,
        way: FloatArray,
        clearance: float,
    ) -> tuple[int | None, int, float] | None:
        """The first that comes nearer than a clearance (m) on a way, None if nothing does.

        Args:
            q: Joints (nq,).
            fixed: Poses of what stands around, in the base, before; the object first.
            forms: Where the forms of the bounds are then; None where bounds do not pay.
            way: How the hand moves (3,), m, base axes.
            clearance: m, above ``LEAST_STEP``.

        Returns:
            Number of the pair, or None and the number of the hand's geometry for a pair with the
            mesh; and its distance, m.
        """
        after = [SE3(pose.rotation, pose.translation - way) for pose in fixed]
        unsure = self._unsure(self._convex, forms, way, clearance)
        if (
            len(unsure) > 0
            and not self._stays_clear(
                [self._lie(unsure, q, poses) for poses in (fixed, after)], way, clearance
            ).all()
        ):
            found = self._follow_convex(q, fixed, way, clearance)
            if found is not None:
                return found[0], 0, found[1]
        if self._mesh is None or self._hull is None:
            return None
        near = self._unsure(self._with_mesh, forms, way, clearance)
        bodies = self._first[near]
        if len(bodies) == 0:
            return None
        ends = [self._lie_to_hull(bodies, q, poses[0]) for poses in (fixed, after)]
        bodies = bodies[~self._stays_clear(ends, way, clearance)]
        self._pairs.place(q, fixed)
        self._mesh.place(self._pairs.poses, fixed[0])
        body = self._mesh.follow(bodies, way, clearance, LEAST_STEP, LONGEST_STEP)
        return None if body is None else (None, *body)

    def _unsure(
        self, numbers: IntArray, forms: FloatArray | None, way: FloatArray, clearance: float
    ) -> IntArray:
        """Which pairs, by their numbers, are not clear for certain by the forms around them."""
        if forms is None:
            return numbers
        return numbers[~self._placed.bounds.clear_along(forms, numbers, way, clearance)]

    def _lie(self, numbers: IntArray, q: FloatArray, fixed: list[SE3]) -> PairQuery:
        self._pairs.place(q, fixed)
        return self._pairs.at(numbers)

    def _lie_to_hull(self, bodies: IntArray, q: FloatArray, pose: SE3) -> PairQuery:
        hull: Any = self._hull
        hull.place(q, [pose])
        lying: PairQuery = hull.at(bodies)
        return lying

    def _stays_clear(
        self, ends: list[PairQuery], way: FloatArray, clearance: float
    ) -> NDArray[np.bool_]:
        """Which pairs (k,) are clear for certain on a way between two ends at which they are known.

        A pair that coal has no normal for is none of them.
        """
        error = NORMAL_ERROR * float(np.linalg.norm(way))
        (begin, slope), (end, final) = (
            (distances, -rows[:, 6:] @ way) for _, distances, rows in ends
        )
        slope, final = slope - error, final + error
        # where the tangents of both ends meet, if they do on the way
        bend = np.maximum(final - slope, error) if error > 0.0 else np.ones(len(slope))
        share = np.clip((begin - end + final) / bend, 0.0, 1.0)
        lines = np.maximum(begin + share * slope, end - (1.0 - share) * final)
        least = np.minimum(lines, np.minimum(begin, end))
        least = np.where(slope >= 0.0, begin, np.where(final <= 0.0, end, least))
        return np.asarray(least >= clearance)  # never of NaN

    def _follow_convex(
        self, q: FloatArray, fixed: list[SE3], way: FloatArray, clearance: float
    ) -> tuple[int, float] | None:
        """The first convex pair nearer than a clearance (m), and its distance."""
        length, done = float(np.linalg.norm(way)), 0.0
        while True:
            shift = way * (done / length if length > 0.0 else 0.0)
            self._pairs.place(q, [SE3(p.rotation, p.translation - shift) for p in fixed])
            k, distance = self._pairs.nearest(self._chosen)
            if distance < clearance:
                return k, distance
            if done >= length:
                return None
            done = min(length, done + max(distance - clearance, LEAST_STEP))
