"""Balls that stand for the links in the NLP's clearance constraints.

Smooth distances are cheap for a ball: the clearance of its centre less its radius. Against the
object, links are filled with balls, so the NLP sees a slightly smaller link. Against the table the
hull's corners are enough, and exact for spheres, capsules and boxes: a capsule's two ends, a
box's eight corners, a prism around a cylinder (balls of radius 0). Between fingers a few balls of the last two links count:
those meet first. The verdict on the true geometry is coal's (``planner.synthesis.verify``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, product
from typing import Any

import casadi as ca
import numpy as np

from planner.bridge import LinkGeometry
from planner.hand import Hand
from planner.spatial import FloatArray
from planner.symbolic import SymbolicHand
from planner.synthesis.surfaces import Surface, box_clearance

__all__ = ["ClearanceTerms", "LinkBall", "finger_pairs", "hull_balls", "link_balls"]

SPACING = 2.0
"""Largest distance between neighbouring balls of a link, in radii."""

_PAD_OVERLAP = 1e-6
"""A ball closer (m) to a pad's centre than this is the pad itself."""


@dataclass(frozen=True, kw_only=True)
class LinkBall:
    """A ball fixed in a joint's frame.

    Attributes:
        geometry: Name of the geometry it stands for.
        finger: Name of the finger it belongs to, "" for palm, wrist and base.
        joint_id: Pinocchio joint it moves with.
        center: (3,), m, in the joint's frame.
        radius: m.
        is_pad: Whether it is the finger's pad, which may touch the object.
        on_tip: Whether it belongs to the body that carries the pad.
    """

    geometry: str
    finger: str
    joint_id: int
    center: FloatArray
    radius: float
    is_pad: bool
    on_tip: bool


class ClearanceTerms:
    """Clearances of a hand as CasADi expressions, each at least 0 where it must be.

    All in the object's frame: a point b of the base is at rotation @ b + shift.
    """

    def __init__(self, symbolic: SymbolicHand, rotation: Any, shift: Any) -> None:
        """Place the balls of every link."""
        self._at = lambda ball: rotation @ symbolic.point(ball.joint_id, ball.center) + shift
        self._hand = symbolic.hand
        self._balls = link_balls(symbolic.hand)
        self._centers = [self._at(b) for b in self._balls]

    def from_object(
        self, surface: Surface, size: Any, touching: Sequence[str], margin: Any, tip_margin: Any
    ) -> list[Any]:
        """Distance of every ball but the pads of the fingers in ``touching``, less a margin (m)."""
        out = []
        for ball, center in zip(self._balls, self._centers, strict=True):
            touches = ball.finger in touching
            if not (ball.is_pad and touches):
                least = tip_margin if ball.on_tip and touches else margin
                out.append(surface.clearance(size, center) - ball.radius - least)
        return out

    def from_plane(self, normal: Any, offset: Any, margin: Any) -> list[Any]:
        """Height of every link over the plane normal . x = offset, less a margin (m)."""
        return [
            ca.dot(normal, self._at(b)) - offset - b.radius - margin for b in hull_balls(self._hand)
        ]

    def from_box(self, rotation: Any, shift: Any, half: Any, margin: Any) -> list[Any]:
        """Distance from a box; a point x is at rotation @ x + shift in the box's frame."""
        return [
            box_clearance(half, rotation @ center + shift) - ball.radius - margin
            for ball, center in zip(self._balls, self._centers, strict=True)
        ]

    def between_fingers(self, margin: Any) -> list[Any]:
        """Squared distances of balls of different fingers, less the least they may be (m2)."""
        return [
            ca.sumsqr(self._centers[a] - self._centers[b])
            - (self._balls[a].radius + self._balls[b].radius + margin) ** 2
            for a, b in finger_pairs(self._balls)
        ]


def link_balls(hand: Hand) -> tuple[LinkBall, ...]:
    """Balls for every colliding geometry of a hand."""
    finger_of = {body: f.name for f in hand.fingers.values() for body in f.bodies}
    out = []
    for geometry in hand.geometries:
        centers, radius = _fill(geometry)
        name = finger_of.get(geometry.body, "")
        for center in centers:
            at = np.array(geometry.T_joint_geometry.act(center))
            out.append(_ball(hand, geometry, name, at, radius))
    return tuple(out)


def hull_balls(hand: Hand) -> tuple[LinkBall, ...]:
    """Balls whose convex hull, link by link, is the link: for clearance from a plane."""
    finger_of = {body: f.name for f in hand.fingers.values() for body in f.bodies}
    out: list[LinkBall] = []
    for geometry in hand.geometries:
        centers, radius = _fill(geometry, corners=True)
        name = finger_of.get(geometry.body, "")
        for center in centers:
            at = np.array(geometry.T_joint_geometry.act(center))
            out.append(_ball(hand, geometry, name, at, radius))
    return tuple(out)


def finger_pairs(balls: tuple[LinkBall, ...]) -> list[tuple[int, int]]:
    """Pairs of balls of different fingers that are kept apart in the NLP.

    Of every geometry on a finger's last two joints the outermost and the middle ball are looked at,
    of the joint before those the middle one.
    """
    outer: dict[str, int] = {}
    for ball in balls:
        if ball.finger:
            outer[ball.finger] = max(outer.get(ball.finger, 0), ball.joint_id)
    by_geometry: dict[str, list[int]] = {}
    for i, ball in enumerate(balls):
        if ball.finger and ball.joint_id >= outer[ball.finger] - 2:
            by_geometry.setdefault(ball.geometry, []).append(i)
    chosen: set[int] = set()
    for members in by_geometry.values():
        ball = balls[members[0]]
        chosen.add(members[len(members) // 2])
        if ball.joint_id >= outer[ball.finger] - 1:
            chosen.add(members[-1])
    return [
        (a, b)
        for a, b in combinations(sorted(chosen), 2)
        if balls[a].finger != balls[b].finger
    ]


def _ball(
    hand: Hand, geometry: LinkGeometry, finger: str, center: FloatArray, radius: float
) -> LinkBall:
    is_pad = on_tip = False
    if finger:
        pad = hand.fingers[finger].pad
        on_tip = geometry.joint_id == pad.joint_id
        is_pad = on_tip and float(np.linalg.norm(center - pad.center)) < _PAD_OVERLAP
    return LinkBall(
        geometry=geometry.name,
        finger=finger,
        joint_id=geometry.joint_id,
        center=center,
        radius=radius,
        is_pad=is_pad,
        on_tip=on_tip,
    )


def _fill(geometry: LinkGeometry, *, corners: bool = False) -> tuple[FloatArray, float]:
    """Ball centres (n, 3) in the geometry's frame and their radius: all through, or the corners."""
    a, b, c = (float(v) for v in geometry.size)
    if geometry.kind == "sphere":
        return np.zeros((1, 3)), a
    if geometry.kind in ("capsule", "cylinder"):
        if corners and geometry.kind == "cylinder":
            return _prism(a, b), 0.0
        # a cylinder's end balls reach exactly to its flat ends
        reach = b if geometry.kind == "capsule" else max(b - a, 0.0)
        z = np.array([-reach, reach]) if corners else _row(reach, a)
        return np.column_stack([np.zeros_like(z), np.zeros_like(z), z]), a
    if geometry.kind in ("box", "ellipsoid"):
        half = np.array([a, b, c])
    else:
        lower, upper = geometry.geometry.aabb_local.min_, geometry.geometry.aabb_local.max_
        half = np.array(upper - lower) / 2
    if corners:
        return np.array(list(product(*([-h, h] for h in half)))), 0.0
    radius = float(half.min())
    rows = [_row(float(h - radius), radius) for h in half]
    grid = np.stack(np.meshgrid(*rows, indexing="ij"), axis=-1).reshape(-1, 3)
    return grid, radius


def _prism(radius: float, half: float) -> FloatArray:
    """Corners (16, 3) of an octagonal prism around a cylinder along z."""
    turns = np.arange(8) * np.pi / 4
    ring = radius / np.cos(np.pi / 8) * np.column_stack([np.cos(turns), np.sin(turns)])
    return np.vstack([np.column_stack([ring, np.full(8, z)]) for z in (-half, half)])


def _row(reach: float, radius: float) -> FloatArray:
    """Evenly spaced coordinates from -reach to reach, no further apart than ``SPACING`` radii."""
    count = int(np.ceil(2 * reach / (SPACING * radius))) + 1 if reach > 0 else 1
    return np.linspace(-reach, reach, count)
