"""Distances that a posture keeps: between parts of the hand, and from the handle it holds."""

from __future__ import annotations

from collections.abc import Collection
from itertools import combinations
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from planner.bridge import LinkGeometry
from planner.hands.hand import Hand
from planner.proximity.convex import DistancePair
from planner.spatial import SE3, FloatArray

__all__ = ["TOUCHING", "HandGaps"]

TOUCHING = -5e-5
"""Signed distance (m) below which two parts of a hand overlap."""


class HandGaps:
    """Signed distances by coal at joint placements that somebody else computed."""

    def __init__(self, hand: Hand, near: float) -> None:
        """Collect the pairs that must not touch.

        Args:
            hand: The hand.
            near: Pairs whose bounding balls are further apart than this (m) are not measured.
        """
        self._geometries, self._near = hand.geometries, near
        self._balls = [_bounding_ball(g.geometry) for g in hand.geometries]
        self._pairs = [
            (i, j, DistancePair(a.geometry, b.geometry))
            for (i, a), (j, b) in combinations(enumerate(hand.geometries), 2)
            if a.joint_id != b.joint_id and frozenset((a.name, b.name)) not in hand.allowed_pairs
        ]
        self._handles: dict[tuple[float, float], list[DistancePair]] = {}

    @property
    def pairs(self) -> tuple[tuple[LinkGeometry, LinkGeometry], ...]:
        """The geometries (n_pairs) whose distances ``between_parts`` gives."""
        return tuple((self._geometries[i], self._geometries[j]) for i, j, _ in self._pairs)

    def between_parts(self, placements: Any) -> FloatArray:
        """Signed distance (n_pairs,), m; beyond ``near`` a lower bound.

        Args:
            placements: Pose of every Pinocchio joint in the base.
        """
        poses = [SE3(placements[g.joint_id]) * g.T_joint_geometry for g in self._geometries]
        centers = np.array([p.act(b[0]) for p, b in zip(poses, self._balls, strict=True)])
        out = np.empty(len(self._pairs))
        for k, (i, j, pair) in enumerate(self._pairs):
            reach = self._balls[i][1] + self._balls[j][1]
            bound = float(np.linalg.norm(centers[i] - centers[j])) - reach
            out[k] = bound if bound > self._near else pair.distance(poses[i], poses[j])
        return out

    def from_handle(
        self,
        placements: Any,
        touching: Collection[int],
        middle: FloatArray,
        along: FloatArray,
        half: float,
        radius: float,
    ) -> FloatArray:
        """Signed distance of a capsule from all parts but those on the joints ``touching``, m.

        Args:
            placements: Pose of every Pinocchio joint in the base.
            touching: Pinocchio joints whose geometries may touch it.
            middle: Middle (3,) of the capsule, m.
            along: Its axis (3,), unit.
            half: Half its length without the ends, m.
            radius: m.
        """
        parts = [g for g in self._geometries if g.joint_id not in touching]
        if (radius, half) not in self._handles:
            handle = coal.Capsule(radius, 2 * half)
            self._handles[radius, half] = [DistancePair(handle, g.geometry) for g in parts]
        turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), along)
        pose = SE3(turn.toRotationMatrix(), middle)
        return np.array(
            [
                pair.distance(pose, SE3(placements[g.joint_id]) * g.T_joint_geometry)
                for pair, g in zip(self._handles[radius, half], parts, strict=True)
            ]
        )


def _bounding_ball(geometry: Any) -> tuple[FloatArray, float]:
    """Centre (3,) in the geometry's frame and radius (m) of the ball around its bounding box."""
    geometry.computeLocalAABB()
    return np.array(geometry.aabb_center), float(geometry.aabb_radius)
