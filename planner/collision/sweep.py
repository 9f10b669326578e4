"""Whether a hand that moves straight, without turning, keeps clear of what stands around.

The distance of two convex bodies is a convex function of such a way: its value and its slope at
both ends bound it from below. Most bodies are proven clear by that; of a mesh the convex hull is
taken, which is not farther than the mesh. The others are followed without a gap: from a place with
distance d, a body may move by d less the clearance.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from planner.collision.pair_table import PairTable
from planner.hands.hand import Hand
from planner.kinematics.link_bounds import LinkBounds
from planner.proximity.convex_pairs import GeometryPairs, PairQuery
from planner.proximity.mesh_pairs import MeshPairs
from planner.shapes import Mesh
from planner.spatial import SE3, FloatArray, IntArray

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

    def __init__(
        self,
        pairs: GeometryPairs,
        table: PairTable,
        bounds: LinkBounds,
        mesh: MeshPairs | None,
        hull: GeometryPairs | None,
    ) -> None:
        """Keep the queries.

        Args:
            pairs: All pairs of the world.
            table: Which they are.
            bounds: Of their distances.
            mesh: Those of the hand and the object, if it is a mesh.
            hull: The same with its convex hull.
        """
        self._pairs, self._bounds, self._mesh, self._hull = pairs, bounds, mesh, hull
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
        return numbers[~self._bounds.clear_along(forms, numbers, way, clearance)]

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
