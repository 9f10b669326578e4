"""Signed distance of a convex geometry and a closed triangle mesh: coal, and an inside for it.

coal measures to the triangles and knows no inside: a body wholly inside a mesh is apart from every
triangle. Two bodies whose surfaces do not meet are apart, or one contains the other; a point of the
convex body tells which. Where surfaces cross, or the body is inside, its depth is the length of the
way out (``planner.proximity.mesh_depth``). Of a ball that is the signed distance of its centre less
its radius, exactly, except where it is in two surfaces at a time.
"""

from __future__ import annotations

from typing import Any, Protocol

import coal
import numpy as np
from numpy.typing import NDArray

from planner.proximity.convex import Proximity
from planner.proximity.mesh_depth import TOLERANCE, Exit, Moved, Start, shortest_exit
from planner.spatial import SE3, FloatArray


class ClosedMesh(Protocol):
    """What is asked of a mesh; ``planner.shapes.Mesh`` has it."""

    @property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Corners (3,) of the bounding box, m."""
        ...

    @property
    def hull_planes(self) -> FloatArray:
        """Planes (k, 4) of the convex hull."""
        ...

    def coal_geometry(self) -> Any:
        """Coal's tree of triangles."""
        ...

    def signed_distance(self, points: FloatArray) -> FloatArray:
        """Exact, (n,), m, of points (n, 3)."""
        ...

    def closest_point(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Surface points and normals, (n, 3) each, of points (n, 3)."""
        ...

    def support(self, direction: FloatArray) -> float:
        """Largest coordinate (m) of the solid along a unit direction (3,)."""
        ...

    def field(self) -> Any:
        """The smooth distance."""
        ...


CROSSING = 1e-6
"""Distance (m) up to which coal's word that two surfaces are apart is not believed: its accuracy.
It gives 0 for some that cross."""

UNIT = 1e-3
"""How far (-) the length of coal's normals may be from 1."""


class MeshPair:
    """A convex geometry and a mesh, asked for at many poses; the counterpart of ``DistancePair``.

    Attributes:
        geometry: Convex coal geometry.
        mesh: Closed mesh, a shape.
        inner: A point (3,) of the geometry, m, in its frame.
    """

    def __init__(self, geometry: Any, mesh: ClosedMesh) -> None:
        """Prepare the query."""
        self.geometry, self.mesh = geometry, mesh
        self._triangles = mesh.coal_geometry()  # coal's functor holds bare pointers
        self._radius = float(geometry.radius) if isinstance(geometry, coal.Sphere) else None
        # coal gives minus the radius for some spheres that are far from the triangles
        self._measured = geometry if self._radius is None else coal.Sphere(0.0)
        self._compute = coal.ComputeDistance(self._measured, self._triangles)
        self._request, self._result = coal.DistanceRequest(), coal.DistanceResult()
        self._exit: Exit | None = None
        self.inner = np.array(geometry.computeCOM())

    def distance(self, pose: SE3, pose_mesh: SE3) -> float:
        """Signed distance, m; negative where they share a point.

        Args:
            pose: ``T_world_geometry``.
            pose_mesh: ``T_world_mesh``.
        """
        inner = pose_mesh.actInv(pose.act(self.inner))[None]
        maybe_inside = bool(maybe_within(self.mesh, inner)[0])
        at = coal.Transform3s(pose), coal.Transform3s(pose_mesh)
        return self.distance_below(*at, np.inf, inner, maybe_inside=maybe_inside)

    def distance_below(
        self,
        pose: Any,
        pose_mesh: Any,
        limit: float,
        inner: FloatArray,
        *,
        maybe_inside: bool,
    ) -> float:
        """Signed distance, m, or at least ``limit`` where it is not below that.

        Args:
            pose: ``T_world_geometry``, a ``coal.Transform3s``.
            pose_mesh: ``T_world_mesh``, likewise.
            limit: m, above 0.
            inner: The point ``inner`` in the mesh's frame, (1, 3), m.
            maybe_inside: Whether that point may be inside the mesh, see ``maybe_within``.
        """
        reach = 0.0 if self._radius is None else self._radius
        result, self._exit = self._result, None
        result.clear()
        if limit < np.inf:
            result.min_distance = limit + reach
        found = self._compute(pose, pose_mesh, self._request, result)
        # at the limit it is the limit, and not a rounding error less
        distance = float(found) - reach if found < limit + reach else limit
        if maybe_inside:
            within = float(self.mesh.signed_distance(inner)[0])
            if self._radius is not None:
                distance = within - reach
            elif within < 0.0:
                distance = min(distance, within)
        if distance > CROSSING:
            return distance
        # out of the triangle that coal calls deepest, or from inside of all to the nearest
        guess = pose_mesh.getRotation().T @ np.array(result.normal)
        way_out = self._leave(pose_mesh.inverseTimes(pose), guess if found > CROSSING else -guess)
        if self._radius is not None and way_out.way <= TOLERANCE - distance:
            return distance  # exact; more only where it is in two surfaces at a time
        self._exit = way_out
        return -way_out.way

    def _leave(self, pose: Any, guess: FloatArray) -> Exit:
        """The way out of the mesh from a pose in its frame; a guess (3,) of its direction."""
        mesh, result = self.mesh, self._result
        reach = 0.0 if self._radius is None else self._radius
        rotation, begin = pose.getRotation(), pose.getTranslation()
        middle = begin + rotation @ self.inner
        surface, outward = mesh.closest_point(middle[None])
        identity, at = coal.Transform3s.Identity(), coal.Transform3s(pose)

        def moved(way: FloatArray, bound: float) -> Moved:
            at.setTranslation(begin + way)
            result.clear()
            if bound < np.inf:
                result.min_distance = bound + reach
            distance = float(self._compute(at, identity, self._request, result))
            on_mesh, normal = np.array(result.getNearestPoint2()), -np.array(result.normal)
            inner = (middle + way)[None]
            if distance > 0.0 and maybe_within(mesh, inner)[0]:
                within = float(mesh.signed_distance(inner)[0])
                if within < 0.0:
                    distance, normal = within, -normal
            return Moved(distance=distance - reach, normal=normal, on_mesh=on_mesh)

        def start_of(along: FloatArray) -> Start:
            beyond = coal.Halfspace(along, float(along @ surface[0]))
            result.clear()
            likely = -coal.distance(
                self.geometry, coal.Transform3s(pose), beyond, identity, self._request, result
            )
            certain = likely + mesh.support(along) - float(along @ surface[0]) + TOLERANCE
            return Start(along=along, likely=likely, certain=certain)

        def outward_at(point: FloatArray) -> FloatArray:
            return np.asarray(mesh.closest_point(point[None])[1][0])

        starts = [outward[0]]
        if abs(float(np.linalg.norm(guess)) - 1.0) < UNIT:  # coal has none where it failed
            starts.append(guess)
        return shortest_exit(moved, starts, start_of, outward_at)

    def last_points(self, distance: float, pose_mesh: SE3) -> FloatArray:
        """Nearest points (3,) + (3,) and normal (3,) of the last query, which gave a distance (m).

        Of a geometry that is in the mesh, the points that part last on its way out.

        Args:
            distance: m.
            pose_mesh: ``T_world_mesh`` of that query.
        """
        result = self._result
        if self._exit is not None:
            on_mesh = pose_mesh.act(self._exit.on_mesh)
            normal = -(pose_mesh.rotation @ self._exit.along)
            return np.concatenate([on_mesh - distance * normal, on_mesh, normal])
        point, on_mesh = np.array(result.getNearestPoint1()), np.array(result.getNearestPoint2())
        if self._radius is None:
            return np.concatenate([point, on_mesh, result.normal])
        normal = (on_mesh - point) / (distance + self._radius)  # turned about where it is inside
        return np.concatenate([point + self._radius * normal, on_mesh, normal])

    def query(self, pose: SE3, pose_mesh: SE3) -> Proximity:
        """Distance, nearest points and normal.

        Args:
            pose: ``T_world_geometry``.
            pose_mesh: ``T_world_mesh``.
        """
        distance = self.distance(pose, pose_mesh)
        if self._radius is not None and self._exit is None:
            return self._from_sphere(distance, pose, pose_mesh, self._radius)
        row = self.last_points(distance, pose_mesh)
        return Proximity(distance=distance, point_a=row[:3], point_b=row[3:6], normal=row[6:])

    def _from_sphere(self, distance: float, pose: SE3, pose_mesh: SE3, radius: float) -> Proximity:
        surface, outward = self.mesh.closest_point(pose_mesh.actInv(pose.translation)[None])
        normal = -(pose_mesh.rotation @ outward[0])
        return Proximity(
            distance=distance,
            point_a=pose.translation + radius * normal,
            point_b=pose_mesh.act(surface[0]),
            normal=normal,
        )


def maybe_within(mesh: ClosedMesh, points: FloatArray) -> NDArray[np.bool_]:
    """Which points (n, 3), m, may be inside a mesh, (n,); the others are outside for certain."""
    lower, upper = mesh.bounds
    maybe = np.asarray(((points >= lower) & (points <= upper)).all(axis=1))
    if maybe.any():
        planes = mesh.hull_planes
        maybe[maybe] = (points[maybe] @ planes[:, :3].T <= -planes[:, 3]).all(axis=1)
    if maybe.any():
        field = mesh.field()
        maybe[maybe] = field.value(points[maybe]) <= field.error
    return np.asarray(maybe)
