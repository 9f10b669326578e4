"""Distances between the parts of a hand, and parts that overlap in many postures of grasps.

A start lies between the postures ``open`` and ``pinch``, or a little beyond, with every joint moved
at random. Where two links overlap in a large share of such postures, that share of the attempts is
lost before it begins, without any other sign.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from planner.bridge import LinkGeometry
from planner.describe.proposal import Findings
from planner.hands.hand import Hand
from planner.joints.couplings import nearest_on_couplings
from planner.kinematics import HandState
from planner.shapes.convex_pairs import DistancePair
from planner.spatial import SE3, FloatArray

TOUCHING = -5e-5
"""Signed distance (m) below which two parts of a hand overlap."""

STANDSTILL = 1e-4
"""Motion (m) below which the last known distances stay the reference: finite differences."""

POSTURES = 200
"""Sampled postures: the standard error of a share of 20 % is 3 %."""

BEYOND = 0.25
"""Share of the way from open to pinch by which postures go beyond either end."""

SPREAD = 0.1
"""Standard deviation of each joint about that way, in shares of its range."""

OFTEN = 0.2
"""Share of the postures from which on an overlap of a link with one that carries it is reported:
every fifth attempt."""

HALF = 0.5
"""The same for links of two fingers, which the solver moves apart: neighbours overlap in many
random postures of a sound hand. From here on most attempts are lost."""

ALWAYS = 0.9
"""Share from which on an overlap is reported as built into the model."""


def separate_pairs(hand: Hand) -> list[tuple[int, int]]:
    """Numbers of the geometries of a hand, two by two, that move apart and must not touch."""
    return [
        (i, j)
        for (i, a), (j, b) in combinations(enumerate(hand.geometries), 2)
        if a.joint_id != b.joint_id and frozenset((a.name, b.name)) not in hand.allowed_pairs
    ]


def placed_geometries(hand: Hand, q: FloatArray) -> list[SE3]:
    """Pose of each geometry of a hand in its base at joints (nq,)."""
    state = HandState(hand, q)
    return [SE3(state.joint_pose(g.joint_id)) * g.T_joint_geometry for g in hand.geometries]


class HandGaps:
    """Signed distances by coal at joint placements that the caller computed."""

    def __init__(self, hand: Hand, near: float) -> None:
        """Collect the pairs that must not touch.

        Args:
            hand: The hand.
            near: Pairs whose bounding balls are further apart than this (m) are not measured.
        """
        self._geometries, self._near = hand.geometries, near
        self._balls = _balls(hand.geometries)
        self._joints = sorted({g.joint_id for g in hand.geometries})
        self._place = np.array([self._joints.index(g.joint_id) for g in hand.geometries], dtype=int)
        self._pairs = np.array(separate_pairs(hand), dtype=int).reshape(-1, 2)
        self._exact: dict[tuple[int, int], DistancePair] = {}
        self._handles: dict[tuple[float, float], list[DistancePair]] = {}
        self._last: tuple[FloatArray, FloatArray, FloatArray] | None = None

    @property
    def pairs(self) -> tuple[tuple[LinkGeometry, LinkGeometry], ...]:
        """The geometries (n_pairs) whose distances ``between_parts`` gives."""
        return tuple((self._geometries[i], self._geometries[j]) for i, j in self._pairs)

    def between_parts(self, placements: Any) -> FloatArray:
        """Signed distance (n_pairs,), m; beyond ``near`` a lower bound.

        Args:
            placements: Pose of every Pinocchio joint in the base.
        """
        centers, turns = self._placed(placements)
        first, second = self._pairs.T
        radii = self._balls[1]
        apart = np.linalg.norm(centers[first] - centers[second], axis=1)
        out = np.asarray(apart - radii[first] - radii[second])
        moved = np.full(len(centers), np.inf)
        if self._last is not None:
            # no point of a part has moved further than this since its distances were known
            moved = np.linalg.norm(centers - self._last[0], axis=1)
            moved += radii * np.linalg.norm(turns - self._last[1], axis=(1, 2))
            out = np.maximum(out, self._last[2] - moved[first] - moved[second])
        for k in np.flatnonzero(out <= self._near):
            i, j = int(first[k]), int(second[k])
            a, b = self._geometries[i], self._geometries[j]
            if (i, j) not in self._exact:
                self._exact[i, j] = DistancePair(a.geometry, b.geometry)
            out[k] = self._exact[i, j].distance(
                SE3(placements[a.joint_id]) * a.T_joint_geometry,
                SE3(placements[b.joint_id]) * b.T_joint_geometry,
            )
        if moved.max(initial=0.0) > STANDSTILL:
            self._last = centers, turns, out.copy()
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

        Beyond ``near`` it is a lower bound.

        Args:
            placements: Pose of every Pinocchio joint in the base.
            touching: Pinocchio joints whose geometries may touch it.
            middle: Middle (3,) of the capsule, m.
            along: Its axis (3,), unit.
            half: Half its length without the ends, m.
            radius: m.
        """
        if (radius, half) not in self._handles:
            handle = coal.Capsule(radius, 2 * half)
            pairs = [DistancePair(handle, g.geometry) for g in self._geometries]
            self._handles[radius, half] = pairs
        to_centers = self._placed(placements)[0] - middle
        shift = np.clip(to_centers @ along, -half, half)
        away = np.linalg.norm(to_centers - shift[:, None] * along, axis=1)
        out = away - self._balls[1] - radius
        out[[g.joint_id in touching for g in self._geometries]] = np.inf
        turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), along)
        pose = SE3(turn.toRotationMatrix(), middle)
        for k in np.flatnonzero(out <= self._near):
            g = self._geometries[k]
            placed = SE3(placements[g.joint_id]) * g.T_joint_geometry
            out[k] = self._handles[radius, half][k].distance(pose, placed)
        return np.asarray(out)

    def _placed(self, placements: Any) -> tuple[FloatArray, FloatArray]:
        """Centres (n, 3), m, of bounding balls in the base, turns (n, 3, 3) of geometries."""
        local = self._balls[0]
        turns = np.array([placements[k].rotation for k in self._joints])[self._place]
        shifts = np.array([placements[k].translation for k in self._joints])[self._place]
        return (turns @ local[:, :, None])[:, :, 0] + shifts, turns


def _balls(geometries: Sequence[LinkGeometry]) -> tuple[FloatArray, FloatArray]:
    """Balls around bounding boxes: centres (n, 3) in the joints' frames and radii (n,), m."""
    centers, radii = [], []
    for g in geometries:
        g.geometry.computeLocalAABB()
        centers.append(g.T_joint_geometry.act(np.array(g.geometry.aabb_center)))
        radii.append(float(g.geometry.aabb_radius))
    return np.array(centers).reshape(-1, 3), np.array(radii)


@dataclass(frozen=True, kw_only=True)
class Overlap:
    """Two bodies that overlap: their names, two of their geoms, and the share of the postures."""

    bodies: tuple[str, str]
    geoms: tuple[str, str]
    share: float

    @property
    def text(self) -> str:
        """The fault, in words."""
        return (
            f"{self.geoms[0]} and {self.geoms[1]} overlap in {100 * self.share:.0f} % of the "
            f"postures between open and pinch: so many attempts "
            + ("are lost" if self.share < HALF else "are lost, and hardly any grasp is found")
        )

    @property
    def remedy(self) -> str:
        """The remedy."""
        line = f'exclude = [["{self.bodies[0]}", "{self.bodies[1]}"]] under [repair]'
        if self.share >= ALWAYS:
            return f"they overlap by construction: write {line}"
        return (
            f"if they are drawn too thick and pass each other on the real hand, write {line}; if "
            "they do collide, narrow the joints' ranges, or choose postures open and pinch in "
            "which they are further apart"
        )


def frequent_overlaps(hand: Hand, *, seed: int = 0) -> tuple[Overlap, ...]:
    """Pairs of bodies that overlap in many postures between open and pinch, most frequent first.

    Args:
        hand: The hand, with both postures.
        seed: Of the random joints.
    """
    rng = np.random.default_rng(seed)
    wide, narrow = hand.posture("open"), hand.posture("pinch")
    low, high = hand.q_lower, hand.q_upper
    moving = np.unique(np.concatenate([f.q_index for f in hand.fingers.values()]))
    gaps = HandGaps(hand, 0.0)
    data = hand.pin_model.createData()
    count = np.zeros(len(gaps.pairs), dtype=int)
    for _ in range(POSTURES):
        q = wide + rng.uniform(-BEYOND, 1 + BEYOND) * (narrow - wide)
        q[moving] += SPREAD * (high - low)[moving] * rng.standard_normal(len(moving))
        q = np.clip(q, low, high)
        if hand.couplings:
            kept = nearest_on_couplings(q, hand.couplings, low, high)
            q = q if kept is None else kept
        pin.forwardKinematics(hand.pin_model, data, q)
        count += gaps.between_parts(data.oMi) < TOUCHING
    found: dict[tuple[str, str], Overlap] = {}
    for (a, b), times in zip(gaps.pairs, count, strict=True):
        share = times / POSTURES
        bodies = (a.body, b.body)
        carried = hand.pin_model.supports[b.joint_id], hand.pin_model.supports[a.joint_id]
        in_line = a.joint_id in list(carried[0]) or b.joint_id in list(carried[1])
        if share >= (OFTEN if in_line else HALF) and (
            bodies not in found or share > found[bodies].share
        ):
            found[bodies] = Overlap(bodies=bodies, geoms=(a.name, b.name), share=float(share))
    return tuple(sorted(found.values(), key=lambda o: -o.share))


def check_overlaps(hand: Hand, findings: Findings) -> None:
    """Note pairs that overlap often in the postures that grasps start from."""
    if not {"open", "pinch"} <= set(hand.description.postures):
        return  # the missing ones are an error already
    for overlap in frequent_overlaps(hand):
        findings.warning(overlap.text, overlap.remedy)
