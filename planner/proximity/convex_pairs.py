"""Distances of many pairs of geometries at one configuration, all in one call.

Pinocchio places the geometries and runs coal over the pairs: 0.25 us a pair of convex geometries, a
fortieth of what a query of ``planner.proximity.convex`` takes from Python, with the same stopping
rule and the same numbers. Where coal fails or is known to err, ``planner.proximity.convex`` has the
last word.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from planner.proximity.convex import FAILED, DistancePair, distance_request
from planner.spatial import SE3, FloatArray, IntArray

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
