"""Links of fingers as capsules, and which of them can collide with those of another finger.

Between fingers, capsules along the last three links keep apart where they can meet at all.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations
from typing import Any

import casadi as ca
import numpy as np

from planner.bridge import LinkGeometry
from planner.hands.hand import Hand
from planner.kinematics import HandState, MovingHand
from planner.spatial import FloatArray
from planner.synthesis.link_spheres import fill, span


@dataclass(frozen=True, kw_only=True)
class LinkCapsule:
    """A capsule along a finger's link: the points within ``radius`` of a segment.

    Attributes:
        finger: Name of the finger.
        joint_id: Pinocchio joint it moves with.
        inner: End of the segment nearer to the joint, (3,), m, in the joint's frame.
        outer: The other end; equal to ``inner`` for a sphere.
        radius: m.
    """

    finger: str
    joint_id: int
    inner: FloatArray
    outer: FloatArray
    radius: float


@lru_cache(maxsize=8)
def finger_capsules(hand: Hand) -> tuple[LinkCapsule, ...]:
    """A capsule for every geometry on the last three joints of every finger."""
    finger_of = hand.finger_of_body
    last = {
        name: sorted({g.joint_id for g in hand.geometries if finger_of.get(g.body) == name})[-3:]
        for name in hand.fingers
    }
    out = []
    for g in hand.geometries:
        name = finger_of.get(g.body, "")
        if not name or g.joint_id not in last[name]:
            continue
        centers, radius = _capsule(hand, g, name)
        ends = [np.array(g.T_joint_geometry.act(c)) for c in (centers[0], centers[-1])]
        ends.sort(key=lambda end: float(np.linalg.norm(end)))
        out.append(
            LinkCapsule(
                finger=name, joint_id=g.joint_id, inner=ends[0], outer=ends[1], radius=radius
            )
        )
    return tuple(out)


@lru_cache(maxsize=8)
def capsules_are_true(hand: Hand) -> bool:
    """Whether the capsules of all fingers are their links' true surfaces."""
    fingers = hand.finger_of_body
    return all(g.kind in ("sphere", "capsule") for g in hand.geometries if g.body in fingers)


def _capsule(hand: Hand, geometry: LinkGeometry, finger: str) -> tuple[FloatArray, float]:
    """Ends (2, 3), m, of a capsule, and its radius, m: of bars, half width to half diagonal."""
    centers, radii = fill(geometry)
    if geometry.kind != "box":
        return centers[[0, -1]], float(radii.max())
    points = span(geometry)[0]
    lower, upper = points.min(axis=0), points.max(axis=0)
    half = (upper - lower) / 2
    along = int(np.argmax(half))
    thin, wide = (float(h) for h in np.sort(half)[:2])
    radius = (wide + float(np.hypot(thin, wide))) / 2
    reach = np.eye(3)[along] * max(float(half[along]) - radius, 0.0)
    middle = (lower + upper) / 2
    return np.array([middle - reach, middle + reach]), radius


@lru_cache(maxsize=8)
def collision_pairs(hand: Hand) -> tuple[tuple[int, int], ...]:
    """Pairs (i, j), i < j, of ``finger_capsules`` of different fingers that can meet.

    Found by sampling the joint ranges: most pairs of fingers that are not neighbours never meet.
    The verdict on the true geometry catches pairs that sampling misses.
    """
    capsules = finger_capsules(hand)
    pairs = [
        (i, j)
        for i, j in combinations(range(len(capsules)), 2)
        if capsules[i].finger != capsules[j].finger
    ]
    first, second = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
    joint = np.array([b.joint_id for b in capsules])
    ends = np.array([[b.inner, b.outer] for b in capsules])  # (n_capsules, 2, 3)
    radius = np.array([b.radius for b in capsules])
    least = radius[first] + radius[second] + COLLISION_MARGIN
    matrix, value = hand.coupling_matrix
    project = np.linalg.pinv(matrix) if len(value) else np.zeros((hand.nq, 0))
    rng = np.random.default_rng(0)
    turns, shifts = [], []
    moving = MovingHand(hand, hand.q_lower)
    for _ in range(COLLISION_SAMPLES):
        q = rng.uniform(hand.q_lower, hand.q_upper)
        q = np.clip(q - project @ (matrix @ q - value), hand.q_lower, hand.q_upper)
        poses = moving.move(q).pin_data.oMi
        turns.append(np.array([pose.rotation for pose in poses])[joint])
        shifts.append(np.array([pose.translation for pose in poses])[joint])
    at = np.einsum("snij,nkj->nksi", np.array(turns), ends)
    at += np.array(shifts).transpose(1, 0, 2)[:, None]
    times = np.zeros(len(pairs), dtype=int)
    for k, (i, j) in enumerate(pairs):
        one, other = closest_on_segments(at[i, 0], at[i, 1], at[j, 0], at[j, 1])
        times[k] = np.count_nonzero(np.linalg.norm(other - one, axis=1) < least[k])
    meets = times >= OFTEN * COLLISION_SAMPLES
    return tuple((int(i), int(j)) for i, j in zip(first[meets], second[meets], strict=True))


@lru_cache(maxsize=8)
def rooms_at_rest(hand: Hand) -> FloatArray:
    """Room (n_pairs,), m, between the ``collision_pairs`` in the hand's own postures.

    Fingers that only curl keep their distance from each other, which can be less than a clearance
    between capsules that are wider than the links. A pair is asked for no more than the larger of
    its rooms in the postures ``open`` and ``pinch``; without these postures it is infinite.
    """
    capsules, pairs = finger_capsules(hand), collision_pairs(hand)
    rooms = np.full(len(pairs), -np.inf if set(hand.description.postures) >= POSTURES else np.inf)
    for name in sorted(POSTURES & set(hand.description.postures)):
        poses = HandState(hand, hand.posture(name)).pin_data.oMi
        for k, (i, j) in enumerate(pairs):
            a, b = capsules[i], capsules[j]
            one, other = closest_on_segments(
                *(
                    np.array([poses[c.joint_id].act(end)])
                    for c in (a, b)
                    for end in (c.inner, c.outer)
                )
            )
            apart = float(np.linalg.norm(other - one)) - a.radius - b.radius
            rooms[k] = max(rooms[k], apart - SLACK)
    return rooms


def closest_on_segments(
    p1: FloatArray, q1: FloatArray, p2: FloatArray, q2: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Nearest points (k, 3) on segments p1 q1 and on p2 q2, as ``between_segments``."""
    along, other, apart = q1 - p1, q2 - p2, p1 - p2
    a = np.maximum((along * along).sum(axis=1), POINT_LENGTH**2)
    e = np.maximum((other * other).sum(axis=1), POINT_LENGTH**2)
    b, c = (along * other).sum(axis=1), (along * apart).sum(axis=1)
    f = (other * apart).sum(axis=1)
    s = np.clip((b * f - c * e) / np.maximum(a * e - b * b, PARALLEL * a * e), 0.0, 1.0)
    t = np.clip((b * s + f) / e, 0.0, 1.0)
    s = np.clip((b * t - c) / a, 0.0, 1.0)
    return p1 + s[:, None] * along, p2 + t[:, None] * other


OFTEN = 0.01
"""Share of random configurations in which two capsules must meet to get a row: rarer pairs cost
more in every iteration than they spare in refused candidates."""

COLLISION_SAMPLES = 400
"""Random configurations that ``collision_pairs`` tries, from a fixed seed."""

COLLISION_MARGIN = 0.005
"""Distance (m) below which two capsules meet: the clearance, and an allowance for few samples."""

POSTURES = frozenset({"open", "pinch"})
"""Postures whose distances between fingers are enough."""

SLACK = 1e-4
"""What a finger that curls may lose of its distance from its neighbour, m."""

POINT_LENGTH = 1e-6
"""Length (m) below which a capsule is a sphere."""

PARALLEL = 1e-9
"""Squared sine below which two segments are parallel (-)."""


def between_segments(p1: Any, q1: Any, p2: Any, q2: Any) -> Any:
    """The shortest way (3,) from segment p1 q1 to segment p2 q2, as an expression.

    Ericson, Real-time collision detection, section 5.1.9.
    """
    along, other, apart = q1 - p1, q2 - p2, p1 - p2
    a, e = ca.sumsqr(along), ca.sumsqr(other)
    a, e = ca.fmax(a, POINT_LENGTH**2), ca.fmax(e, POINT_LENGTH**2)
    b, c, f = ca.dot(along, other), ca.dot(along, apart), ca.dot(other, apart)
    s = _share((b * f - c * e) / ca.fmax(a * e - b * b, PARALLEL * a * e))
    t = _share((b * s + f) / e)
    s = _share((b * t - c) / a)
    return p2 + t * other - p1 - s * along


def _share(value: Any) -> Any:
    return ca.fmin(ca.fmax(value, 0), 1)
