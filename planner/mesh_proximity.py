"""Signed distance of a convex geometry and a closed triangle mesh: coal, and an inside for it.

coal measures to the triangles and knows no inside: a body wholly inside a mesh is apart from every
triangle. Two bodies whose surfaces do not meet are apart, or one contains the other; a point of the
convex body tells which. Where surfaces cross, coal's depth is that of single triangles: right to
1e-5 m down to a tenth of a millimetre, too small deeper. Its sign is right throughout.
"""

from __future__ import annotations

from typing import Any, Protocol

import coal
import numpy as np
from numpy.typing import NDArray

from planner.proximity import Proximity
from planner.spatial import SE3, FloatArray

__all__ = ["ClosedMesh", "MeshPair", "maybe_within"]


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

    def field(self) -> Any:
        """The smooth distance."""
        ...


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
        result = self._result
        result.clear()
        if limit < np.inf:
            result.min_distance = limit + reach
        found = self._compute(pose, pose_mesh, self._request, result)
        if self._radius is not None:
            if maybe_inside:
                return float(self.mesh.signed_distance(inner)[0]) - reach
            # at the limit it is the limit, and not a rounding error less
            return float(found) - reach if found < limit + reach else limit
        if found > 0.0 and maybe_inside:
            depth = float(self.mesh.signed_distance(inner)[0])
            if depth < 0.0:
                return depth
        return float(found)

    def last_points(self, distance: float) -> FloatArray:
        """Nearest points (3,) + (3,) and normal (3,) of the last query, which gave a distance (m).

        Those of the nearest triangle; of a body that is in the mesh, the way out of it.
        """
        result = self._result
        point, on_mesh = np.array(result.getNearestPoint1()), np.array(result.getNearestPoint2())
        if self._radius is None:
            return np.concatenate([point, on_mesh, result.normal])
        normal = (on_mesh - point) / (distance + self._radius)  # turned about where it is inside
        return np.concatenate([point + self._radius * normal, on_mesh, normal])

    def query(self, pose: SE3, pose_mesh: SE3) -> Proximity:
        """Distance, nearest points and normal; points of single triangles where surfaces cross.

        Args:
            pose: ``T_world_geometry``.
            pose_mesh: ``T_world_mesh``.
        """
        distance = self.distance(pose, pose_mesh)
        if self._radius is not None:
            return self._from_sphere(distance, pose, pose_mesh, self._radius)
        point = np.array(self._result.getNearestPoint1())
        return Proximity(
            distance=distance,
            point_a=point,
            point_b=np.array(self._result.getNearestPoint2()),
            normal=np.array(self._result.normal),
        )

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
