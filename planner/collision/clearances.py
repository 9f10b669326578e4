"""What a ``CollisionWorld`` answers: how far pairs of geometries are apart, and how they lie."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner.kinematics.state import HandKinematics
from planner.spatial import FloatArray, IntArray

__all__ = ["Clearance", "NearPairs"]


@dataclass(frozen=True, kw_only=True)
class Clearance:
    """Signed distance of one pair: positive apart, negative in penetration.

    Attributes:
        first: Name of a hand geometry.
        second: Name of another one, "object", "table", or an obstacle's name.
        distance: m.
    """

    first: str
    second: str
    distance: float

    def __str__(self) -> str:
        """Names and distance in mm."""
        return f"{self.first} - {self.second}: {1e3 * self.distance:.2f} mm"


@dataclass(frozen=True, kw_only=True, eq=False)
class NearPairs:
    """How pairs that are near to each other lie.

    Attributes:
        numbers: Numbers of the pairs (k,).
        outward: Whether the second is object, table or obstacle, (k,).
        mesh: Whether it is a mesh, (k,).
        joints: Pinocchio joints (k, 2) that the two geometries move with; 0 for what stands still.
        distances: Signed distances (k,), m.
        points_a: Nearest points of the first (k, 3), m.
        points_b: Nearest points of the second (k, 3), m.
        normals: Unit vectors (k, 3) from the first to the second.
    """

    numbers: IntArray
    outward: NDArray[np.bool_]
    mesh: NDArray[np.bool_]
    joints: IntArray
    distances: FloatArray
    points_a: FloatArray
    points_b: FloatArray
    normals: FloatArray

    def rates(self, hand: HandKinematics) -> FloatArray:
        """How the distances change with the joints, (k, nq), of a hand where the pairs are."""
        ahead = hand.point_rates(self.joints[:, 1], self.points_b, self.normals)
        behind = hand.point_rates(self.joints[:, 0], self.points_a, self.normals)
        return ahead - behind
