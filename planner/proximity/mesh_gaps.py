"""``MeshGaps``: how far convex geometries are from the triangles of a mesh, by compiled loops.

The same distances as coal's, in a tenth of its time: exact for boxes, capsules, balls and hulls,
where coal leaves 1e-6 m, and to 1e-11 m for cylinders and ellipsoids. Triangles have no inside:
``planner.proximity.mesh`` has the last word.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from planner.proximity.bodies import ConvexBodies
from planner.proximity.tree_kernels import gaps_to_triangles
from planner.shapes.meshes.nearest_triangle import BallTree
from planner.spatial import FloatArray, IntArray

__all__ = ["MeshGaps"]

NOTHING: FloatArray = np.zeros(0)
"""No known distances."""


class MeshGaps:
    """Convex geometries and the triangles of a mesh, at one placement after the other.

    Attributes:
        bodies: The geometries.
    """

    def __init__(self, bodies: ConvexBodies, tree: BallTree) -> None:
        """Keep the arrays."""
        self.bodies = bodies
        self._of_bodies, self._of_tree = bodies.arrays, tree.arrays
        self._off_centre = bool(bodies.middles.any())

    @classmethod
    def of(cls, geometries: Sequence[Any], mesh: Any) -> MeshGaps | None:
        """The gaps of coal geometries; None where coal alone knows their form."""
        bodies = ConvexBodies.of(geometries)
        return None if bodies is None else cls(bodies, mesh.ball_tree)

    def at(
        self,
        which: IntArray,
        turns: FloatArray,
        shifts: FloatArray,
        *,
        limit: float = np.inf,
        floor: float = 0.0,
        known: FloatArray | None = None,
    ) -> FloatArray:
        """Distances and nearest points, (k, 7): see ``gaps_to_triangles``.

        Args:
            which: Geometries (k,).
            turns: Their rotations in the mesh's frame (k, 3, 3).
            shifts: Their positions there (k, 3), m.
            limit: Distance from which on it is not of interest how large it is, m.
            floor: Distances above this (m) are not of interest if they are not of the smallest.
            known: Distances that are known, ascending, m: how many of them, so many are the
                smallest; None if all are of interest.
        """
        if self._off_centre:
            shifts = shifts + np.einsum("kij,kj->ki", turns, self.bodies.middles[which])
        return gaps_to_triangles(
            *self._of_bodies,
            which,
            np.ascontiguousarray(turns),
            np.ascontiguousarray(shifts),
            *self._of_tree,
            limit,
            floor,
            NOTHING if known is None else known,
        )
