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

from planner.proximity import Proximity
from planner.spatial import SE3, FloatArray

__all__ = ["MeshPair"]


class _Mesh(Protocol):
    def coal_geometry(self) -> Any: ...

    def signed_distance(self, points: FloatArray) -> FloatArray: ...

    def closest_point(self, points: FloatArray) -> tuple[FloatArray, FloatArray]: ...

    def field(self) -> Any: ...


class MeshPair:
    """A convex geometry and a mesh, asked for at many poses; the counterpart of ``DistancePair``.

    Attributes:
        geometry: Convex coal geometry.
        mesh: Closed mesh, a shape.
    """

    def __init__(self, geometry: Any, mesh: _Mesh) -> None:
        """Prepare the query."""
        self.geometry, self.mesh = geometry, mesh
        self._triangles = mesh.coal_geometry()  # coal's functor holds bare pointers
        self._compute = coal.ComputeDistance(geometry, self._triangles)
        self._request, self._result = coal.DistanceRequest(), coal.DistanceResult()
        self._inner = np.array(geometry.computeCOM())

    def distance(self, pose: SE3, pose_mesh: SE3) -> float:
        """Signed distance, m; negative where they share a point.

        Args:
            pose: ``T_world_geometry``.
            pose_mesh: ``T_world_mesh``.
        """
        if isinstance(self.geometry, coal.Sphere):
            # coal gives minus the radius for some spheres that are far from the triangles
            center = pose_mesh.actInv(pose.translation)[None]
            return float(self.mesh.signed_distance(center)[0]) - float(self.geometry.radius)
        self._result.clear()
        found = float(
            self._compute(
                coal.Transform3s(pose.rotation, pose.translation),
                coal.Transform3s(pose_mesh.rotation, pose_mesh.translation),
                self._request,
                self._result,
            )
        )
        if found <= 0.0:
            return found
        inner = pose_mesh.actInv(pose.act(self._inner))[None]
        field = self.mesh.field()
        if field.value(inner)[0] > field.error:  # outside without a closer look
            return found
        depth = self.mesh.signed_distance(inner)[0]
        return float(depth) if depth < 0.0 else found

    def query(self, pose: SE3, pose_mesh: SE3) -> Proximity:
        """Distance, nearest points and normal; exact where they are apart."""
        distance = self.distance(pose, pose_mesh)
        if isinstance(self.geometry, coal.Sphere):
            return self._from_sphere(distance, pose, pose_mesh)
        point = np.array(self._result.getNearestPoint1())
        return Proximity(
            distance=distance,
            point_a=point,
            point_b=np.array(self._result.getNearestPoint2()),
            normal=np.array(self._result.normal),
        )

    def _from_sphere(self, distance: float, pose: SE3, pose_mesh: SE3) -> Proximity:
        surface, outward = self.mesh.closest_point(pose_mesh.actInv(pose.translation)[None])
        normal = -(pose_mesh.rotation @ outward[0])
        return Proximity(
            distance=distance,
            point_a=pose.translation + self.geometry.radius * normal,
            point_b=pose_mesh.act(surface[0]),
            normal=normal,
        )
