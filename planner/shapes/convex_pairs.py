"""Signed distance, nearest points and normal of convex geometries by coal, of one pair or many.

Distances are positive apart and negative in penetration. coal is used with these precautions:
  - Its default stopping rule leaves 1e-6 m in the distance of curved shapes and 0.01 rad in the
    normal; the duality gap at the same tolerance leaves 1e-9 m and 1e-4 rad for 1 us more.
  - Its default of 64 expansion steps is too few for overlapping ellipsoids (4e-5 m left); 1000 are
    allowed here.
  - A query that does not converge (one in 1e5 of thin ellipsoids far from large boxes) is repeated
    with a tolerance ten times looser.
  - A sphere whose centre is inside a cylinder is reported to leave through the side even where an
    end is nearer (20 mm wrong in a 30 mm cylinder); here that case is computed in closed form.
  - Where axes of capsules or centres of spheres meet exactly, its normal is arbitrary; here moving
    along it parts the two.
  - It widens boxes by a share of 1e-10, or does not, as long as a process lives: it depends on
    whether the first direction in which it sought the end of a box had a component of zero (coal 3
    keeps that number). So one is asked along its axes when this module is loaded; else what was
    asked before would decide the last digits of distances, and of one plan in four.
  - A triangle mesh has no inside for coal: it is refused. Give convex pieces or primitives.

Accuracy: 1e-8 m apart and until the cores of rounded shapes touch (the centre of a sphere, the
axis of a capsule); deeper, where coal expands polytopes (EPA), 3e-6 m, and 1e-5 m in
the points. Tighter tolerances make coal fail, so they are not offered. A query takes some 10 us,
but up to 15 ms where centres of curved shapes coincide.

Many pairs at one configuration are one call: Pinocchio places the geometries and runs coal over the
pairs, 0.25 us a pair, a fortieth of what a query takes from Python, with the same stopping rule and
the same numbers. Where coal fails or is known to err, the query of one pair has the last word.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from planner.errors import ModelError
from planner.shapes.base import nearest_on_cylinder
from planner.spatial import SE3, FloatArray, IntArray

GJK_TOLERANCES = (1e-6, 1e-5)
"""Tolerances of coal's distance iteration, and what is tried next if it does not converge."""

MEETING = 1e-12
"""Distance (m) between two cores at which they count as meeting: the rounding of coal's points."""

EPA_ITERATIONS = 1000
"""Steps of polytope expansion that overlapping curved shapes may need to reach 1e-6 m."""

FAILED = 1e6
"""Distances (m) beyond this, of either sign, are not: coal marks a query that did not converge by
1.8e308."""

LEAST_LIMIT = 1e-5
"""Smallest limit (m) that coal is given: its accuracy. Told 0, it would not look for a touch."""

FEW = 5
"""Geometries from which on it pays to bound their distances before they are measured."""


def _widen_boxes() -> None:
    """Have coal ask a box along its axes, before any other is asked; see the module."""
    box, aside = coal.Box(1.0, 1.0, 1.0), coal.Transform3s(np.eye(3), np.array([3.0, 2.0, 1.0]))
    coal.distance(
        box, coal.Transform3s(), box, aside, coal.DistanceRequest(), coal.DistanceResult()
    )


_widen_boxes()


@dataclass(frozen=True, kw_only=True, eq=False)
class Proximity:
    """How near two geometries a and b are; points and normal in world axes.

    ``point_b - point_a == distance * normal``, apart and in penetration.

    Attributes:
        distance: Signed distance, m: positive apart, negative in penetration.
        point_a: Nearest point (3,) of a, m; in penetration the point of a that is deepest in b.
        point_b: Nearest point (3,) of b, m; in penetration the point of b that is deepest in a.
        normal: Unit vector (3,) from a to b: moving b along it parts them.
    """

    distance: float
    point_a: FloatArray
    point_b: FloatArray
    normal: FloatArray


class DistancePair:
    """Two geometries whose distance is asked for at many poses.

    Attributes:
        geometry_a: Convex coal geometry.
        geometry_b: Convex coal geometry.
    """

    def __init__(self, geometry_a: Any, geometry_b: Any) -> None:
        """Prepare the query.

        Raises:
            ModelError: A geometry is a triangle mesh, which has no inside for coal.
        """
        _check_convex("geometry_a", geometry_a)
        _check_convex("geometry_b", geometry_b)
        # coal's functor holds bare pointers: these references keep the geometries alive
        self.geometry_a = geometry_a
        self.geometry_b = geometry_b
        self._compute = coal.ComputeDistance(geometry_a, geometry_b)
        self._requests = tuple(distance_request(tolerance) for tolerance in GJK_TOLERANCES)
        self._result = coal.DistanceResult()
        self._sphere_inside = _sphere_inside(geometry_a, geometry_b)
        self._cores_meet = _cores_meet(geometry_a, geometry_b)

    def distance(self, pose_a: SE3, pose_b: SE3) -> float:
        """Signed distance, m, alone: faster than ``query``.

        Args:
            pose_a: ``T_world_a``.
            pose_b: ``T_world_b``.

        Raises:
            ModelError: coal's iteration did not converge; extreme proportions can cause it.
        """
        transform_a, transform_b = coal.Transform3s(pose_a), coal.Transform3s(pose_b)
        for request in self._requests:
            self._result.clear()
            distance = float(self._compute(transform_a, transform_b, request, self._result))
            if abs(distance) < FAILED:
                break
        else:
            a, b = type(self.geometry_a).__name__, type(self.geometry_b).__name__
            raise ModelError(
                f"coal found no distance of {a} and {b}; check their sizes and poses for extreme "
                "values"
            )
        if distance <= self._sphere_inside:
            return self._cylinder_query(pose_a, pose_b).distance
        return distance

    def query(self, pose_a: SE3, pose_b: SE3) -> Proximity:
        """Distance, nearest points and normal.

        Args:
            pose_a: ``T_world_a``.
            pose_b: ``T_world_b``.

        Raises:
            ModelError: coal's iteration did not converge; extreme proportions can cause it.
        """
        distance = self.distance(pose_a, pose_b)
        if distance <= self._sphere_inside:
            return self._cylinder_query(pose_a, pose_b)
        point_a = np.array(self._result.getNearestPoint1())
        point_b = np.array(self._result.getNearestPoint2())
        normal = np.array(self._result.normal)
        if distance <= self._cores_meet:
            core = point_a - self.geometry_a.radius * normal
            normal = self._across(pose_a, pose_b)
            point_a = core + self.geometry_a.radius * normal
            point_b = core - self.geometry_b.radius * normal
        return Proximity(distance=distance, point_a=point_a, point_b=point_b, normal=normal)

    def _across(self, pose_a: SE3, pose_b: SE3) -> FloatArray:
        """A unit vector (3,) perpendicular to the axes of those geometries that are capsules."""
        axes = [
            pose.rotation[:, 2]
            for pose, geometry in ((pose_a, self.geometry_a), (pose_b, self.geometry_b))
            if isinstance(geometry, coal.Capsule)
        ]
        # the last right singular vector of one or two axes is perpendicular to both
        across: FloatArray = np.linalg.svd(np.array(axes))[2][2]
        return across

    def _cylinder_query(self, pose_a: SE3, pose_b: SE3) -> Proximity:
        if isinstance(self.geometry_a, coal.Cylinder):
            return _cylinder_to_sphere(self.geometry_a, self.geometry_b, pose_a, pose_b)
        p = _cylinder_to_sphere(self.geometry_b, self.geometry_a, pose_b, pose_a)
        return Proximity(
            distance=p.distance, point_a=p.point_b, point_b=p.point_a, normal=-p.normal
        )


def _check_convex(name: str, geometry: Any) -> None:
    if not isinstance(geometry, coal.CollisionGeometry):
        raise ModelError(
            f"{name!r} is a {type(geometry).__name__}, not a coal geometry; give for example "
            "Shape.coal_geometry()"
        )
    if isinstance(geometry, coal.BVHModelBase):
        raise ModelError(
            f"{name!r} is a triangle mesh, which has no inside for coal; give convex pieces "
            "(coal.Convex) or a primitive"
        )


def _cylinder_to_sphere(cylinder: Any, sphere: Any, pose_a: SE3, pose_b: SE3) -> Proximity:
    """From a cylinder (a) to a sphere (b), exact in closed form."""
    center = pose_a.actInv(pose_b.translation)
    surface, normals = nearest_on_cylinder(center[None], cylinder.radius, cylinder.halfLength)
    normal = pose_a.rotation @ normals[0]
    return Proximity(
        distance=float((center - surface[0]) @ normals[0]) - sphere.radius,
        point_a=pose_a.act(surface[0]),
        point_b=pose_b.translation - sphere.radius * normal,
        normal=normal,
    )


def distance_request(tolerance: float = GJK_TOLERANCES[0]) -> Any:
    """How coal is asked; see the module."""
    request = coal.DistanceRequest()
    request.gjk_convergence_criterion = coal.GJKConvergenceCriterion.DualityGap
    request.gjk_tolerance = tolerance
    request.epa_max_iterations = EPA_ITERATIONS
    return request


def _sphere_inside(a: Any, b: Any) -> float:
    """Distance (m) at which the centre of a sphere enters a cylinder, where coal errs."""
    for one, other in ((a, b), (b, a)):
        if isinstance(one, coal.Sphere) and isinstance(other, coal.Cylinder):
            return -float(one.radius)
    return -np.inf


def _cores_meet(a: Any, b: Any) -> float:
    """Distance (m) at which the axis of a capsule meets another axis or the centre of a sphere."""
    kinds = (coal.Sphere, coal.Capsule)
    both_round = isinstance(a, kinds) and isinstance(b, kinds)
    if not both_round or (isinstance(a, coal.Sphere) and isinstance(b, coal.Sphere)):
        return -np.inf
    return MEETING - float(a.radius + b.radius)


Chosen = NDArray[np.bool_]
"""Which pairs, (n_pairs,)."""

PairQuery = tuple[IntArray, FloatArray, FloatArray]
"""Numbers of pairs (k,), their distances (k,), m, and (k, 9): the nearest points of both and the
normal from one to the other, base axes."""


class GeometryPairs:
    """Pairs among geometries that move with a hand and geometries that stand still.

    Distances are those of convex geometries. Of a triangle mesh, which has no inside for coal, only
    ``any_below`` may be asked.
    """

    def __init__(
        self, pin_model: Any, geometries: Any, pairs: Sequence[tuple[int, int]], n_moving: int
    ) -> None:
        """Prepare the queries.

        Args:
            pin_model: Pinocchio's model of the hand.
            geometries: ``pinocchio.GeometryModel``; those that stand still are the last. Pairs are
                added to it.
            pairs: Numbers of two geometries each.
            n_moving: How many geometries move with the hand.
        """
        self._pin_model, self._pin_data = pin_model, pin_model.createData()
        self._model, self._n_moving = geometries, n_moving
        self._index = list(pairs)
        for a, b in pairs:
            geometries.addCollisionPair(pin.CollisionPair(a, b))
        self._placed = self._new_data()
        self._measured: dict[bytes, Any] = {}
        self._limited: dict[tuple[bytes, float], Any] = {}
        self._exact: dict[int, DistancePair] = {}
        self._q = np.full(pin_model.nq, np.nan)
        kinds = [type(g.geometry) for g in geometries.geometryObjects]
        erring = {coal.Sphere, coal.Cylinder}
        self._erring = np.array([{kinds[a], kinds[b]} == erring for a, b in pairs], dtype=bool)

    def place(self, q: FloatArray, fixed: Sequence[SE3]) -> bool:
        """Put everything where it is at q (nq,), with what stands still at poses in the base.

        Returns:
            Whether q is another one than before.
        """
        for i, pose in enumerate(fixed):
            self._model.geometryObjects[self._n_moving + i].placement = pose
        moved = not np.array_equal(q, self._q)
        if moved:
            self._q = np.array(q, dtype=np.float64)
            pin.forwardKinematics(self._pin_model, self._pin_data, self._q)
        self._update(self._placed)
        return moved

    @property
    def poses(self) -> Any:
        """Poses of all geometries in the base, as last placed."""
        return self._placed.oMg

    def nearest(self, which: Chosen) -> tuple[int, float]:
        """The pair of least signed distance (m) among those told; 0 and inf if none."""
        data = self._measure(which)
        k = pin.computeDistances(self._model, data)
        if k >= len(self._index):
            return 0, np.inf
        distance = float(data.distanceResults[k].min_distance)
        # coal marks what it failed at by a huge negative number, and errs in penetration alone
        if distance > 0.0 or (distance > -FAILED and not (which & self._erring).any()):
            return int(k), distance
        asked = np.flatnonzero(which)
        values = self._read(data, asked)
        least = int(np.argmin(values))
        return int(asked[least]), float(values[least])

    def distances(self, which: Chosen) -> FloatArray:
        """Signed distances (m) of the pairs told, in their order."""
        data = self._measure(which)
        pin.computeDistances(self._model, data)
        return self._read(data, np.flatnonzero(which))

    def measure(self, numbers: IntArray) -> FloatArray:
        """Signed distances (m) of pairs by their numbers (k,): quicker than all if they are few."""
        results = [pin.computeDistance(self._model, self._placed, int(k)) for k in numbers]
        return self._checked(np.array([r.min_distance for r in results]), numbers)

    def near(self, which: Chosen, limit: float, maybe: IntArray | None = None) -> PairQuery:
        """How those of the pairs told lie that are nearer than a limit (m).

        Args:
            which: The pairs.
            limit: m.
            maybe: Numbers of those among them that can be so near, ascending; all if None.
        """
        data = self._measure(which)
        pin.computeDistances(self._model, data)
        asked = np.flatnonzero(which) if maybe is None else maybe
        values = self._read(data, asked)
        kept = values < limit
        results = data.distanceResults
        found = [results[int(k)] for k in asked[kept]]
        numbers, distances, rows = _pair_query(asked[kept], values[kept], found)
        told = np.isfinite(rows).all(axis=1)  # coal has no points where it failed
        return numbers[told], distances[told], rows[told]

    def at(self, numbers: IntArray) -> PairQuery:
        """How pairs lie by their numbers (k,), however far; NaN where coal failed."""
        results = [pin.computeDistance(self._model, self._placed, int(k)) for k in numbers]
        return _pair_query(numbers, np.array([r.min_distance for r in results]), results)

    @property
    def count(self) -> int:
        """Number of pairs."""
        return len(self._index)

    def any_below(self, which: Chosen, limit: float) -> bool:
        """Whether surfaces of any of the pairs told are nearer than a limit (m), or cross.

        For limits that are asked for often: each has its queries, which are kept.
        """
        key = which.tobytes(), limit
        if key not in self._limited:
            data = self._new_data(which)
            for k in np.flatnonzero(which):
                data.collisionRequests[int(k)].security_margin = limit
            self._limited[key] = data
        self._update(self._limited[key])
        return bool(pin.computeCollisions(self._model, self._limited[key], True))

    def _new_data(self, which: Chosen | None = None) -> Any:
        data = pin.GeometryData(self._model)
        for k in range(len(self._index)):
            data.distanceRequests[k] = distance_request()
            if which is not None and not which[k]:
                data.deactivateCollisionPair(k)
        return data

    def _update(self, data: Any) -> None:
        pin.updateGeometryPlacements(self._pin_model, self._pin_data, self._model, data)

    def _measure(self, which: Chosen) -> Any:
        """Data for these pairs, everything where it was last placed."""
        key = which.tobytes()
        if key not in self._measured:
            self._measured[key] = self._new_data(which)
        self._update(self._measured[key])
        return self._measured[key]

    def _read(self, data: Any, asked: IntArray) -> FloatArray:
        results = data.distanceResults
        return self._checked(np.array([results[int(k)].min_distance for k in asked]), asked)

    def _checked(self, values: FloatArray, asked: IntArray) -> FloatArray:
        """Distances (k,) that coal told of pairs by their numbers, put right where it errs."""
        doubtful = (np.abs(values) >= FAILED) | (self._erring[asked] & (values < 0.0))
        for i in np.flatnonzero(doubtful):
            values[i] = self._exactly(int(asked[i]))
        return values

    def _exactly(self, k: int) -> float:
        a, b = self._index[k]
        if k not in self._exact:
            first, second = (self._model.geometryObjects[i].geometry for i in (a, b))
            self._exact[k] = DistancePair(first, second)
        return self._exact[k].distance(self._placed.oMg[a], self._placed.oMg[b])


def _pair_query(numbers: IntArray, values: FloatArray, results: list[Any]) -> PairQuery:
    rows = np.empty((len(numbers), 9))
    for row, found in zip(rows, results, strict=True):
        row[:3], row[3:6] = found.getNearestPoint1(), found.getNearestPoint2()
        row[6:] = found.normal
    return numbers, values, rows
