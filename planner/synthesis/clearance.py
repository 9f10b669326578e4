"""Balls that stand for the links in the NLP's clearance constraints.

Smooth distances are cheap for a ball: the clearance of its centre less its radius. Against the
object, links are filled with balls, so the NLP sees a slightly smaller link. Against the table the
hull's corners are enough, and exact for spheres, capsules and boxes: a capsule's two ends, a
box's eight corners, a prism around a cylinder (balls of radius 0). Between fingers the bones of
links, which are capsules, keep away from each other where they can meet at all. The verdict on the
true geometry is coal's (``planner.verification.geometry``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations
from typing import Any

import casadi as ca
import numpy as np
from scipy.spatial import ConvexHull

from planner.bridge import LinkGeometry
from planner.collision.pad_contact import ROUND, pad_geometry
from planner.hands.hand import Hand
from planner.kinematics.state import HandState
from planner.kinematics.symbolic import SymbolicHand
from planner.shapes.surface import Surface, box_clearance
from planner.spatial import FloatArray
from planner.synthesis.filling import fill, span

__all__ = [
    "ClearanceTerms",
    "LinkBall",
    "LinkBone",
    "bones_are_true",
    "closest_on_segments",
    "finger_bones",
    "hull_balls",
    "link_balls",
    "margin_of",
    "meeting_bones",
    "moving",
]

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

    Attributes:
        symbolic: The hand's kinematics.
        hand: The hand.
        rotation: (3, 3).
        balls: Balls that fill the links.
        centers: Their centres.
        corners: Balls that span the links.
    """

    def __init__(
        self,
        symbolic: SymbolicHand,
        rotation: Any,
        shift: Any,
        root: tuple[Any, Any] | None = None,
    ) -> None:
        """Place the balls of every link; ``root`` is rotation and shift of what is cut off."""
        self.symbolic, self.rotation, self._shift, self._root = symbolic, rotation, shift, root
        self.hand = symbolic.hand
        self.balls = moving(symbolic.hand, link_balls(symbolic.hand))
        self.corners = moving(symbolic.hand, hull_balls(symbolic.hand))
        self.centers = [self._place(b.joint_id, b.center) for b in self.balls]

    def local(self, ball: LinkBall) -> Any:
        """Centre of a ball in the base, or in the arm's last link where the hand is cut off."""
        return self.symbolic.point(ball.joint_id, ball.center)

    def bones(self) -> list[tuple[Any, Any]]:
        """Inner and outer end of every finger bone, in the same frame."""
        point = self.symbolic.point
        return [
            (point(b.joint_id, b.inner), point(b.joint_id, b.outer))
            for b in finger_bones(self.hand)
        ]

    def _place(self, joint_id: int, local: FloatArray) -> Any:
        """A point fixed in a joint's frame, in the object's frame."""
        rotation, shift = self.rotation, self._shift
        if self._root is not None and self.symbolic.is_cut_off(joint_id):
            rotation, shift = self._root
        return rotation @ self.symbolic.point(joint_id, local) + shift

    def from_object(
        self, surface: Surface, size: Any, touching: Sequence[str], margin: Any, tip_margin: Any
    ) -> list[Any]:
        """Distance of every ball but the pads of the fingers in ``touching``, less a margin (m)."""
        out = []
        margins = {"clear_object": margin, "clear_tip": tip_margin}
        for ball, center in zip(self.balls, self.centers, strict=True):
            name = margin_of(ball, touching)
            if name is not None:
                least = margins[name]
                reach = ball.radius + least + surface.distance_error
                out.append(surface.clearance(size, center) - reach)
        return out

    def from_plane(self, normal: Any, offset: Any, margin: Any) -> list[Any]:
        """Height of every link over the plane normal . x = offset, less a margin (m)."""
        return [
            ca.dot(normal, self._place(b.joint_id, b.center)) - offset - b.radius - margin
            for b in self.corners
        ]

    def from_box(self, rotation: Any, shift: Any, half: Any, margin: Any) -> list[Any]:
        """Distance from a box; a point x is at rotation @ x + shift in the box's frame."""
        return [
            box_clearance(half, rotation @ center + shift) - ball.radius - margin
            for ball, center in zip(self.balls, self.centers, strict=True)
        ]

    def between_fingers(self, margin: Any) -> list[Any]:
        """Squared distance of bones of different fingers, less the least allowed (m2)."""
        bones = finger_bones(self.hand)
        ends = [(self._place(b.joint_id, b.inner), self._place(b.joint_id, b.outer)) for b in bones]
        out = []
        for i, j in meeting_bones(self.hand):
            arm = between_segments(*ends[i], *ends[j])
            out.append(ca.sumsqr(arm) - (bones[i].radius + bones[j].radius + margin) ** 2)
        return out


def between_segments(p1: Any, q1: Any, p2: Any, q2: Any) -> Any:
    """The shortest way (3,) from segment p1 q1 to segment p2 q2, as an expression.

    Ericson, Real-time collision detection, section 5.1.9.
    """
    along, other, apart = q1 - p1, q2 - p2, p1 - p2
    a, e = ca.sumsqr(along), ca.sumsqr(other)
    a, e = ca.fmax(a, BALL_LENGTH**2), ca.fmax(e, BALL_LENGTH**2)
    b, c, f = ca.dot(along, other), ca.dot(along, apart), ca.dot(other, apart)
    s = _share((b * f - c * e) / ca.fmax(a * e - b * b, PARALLEL * a * e))
    t = _share((b * s + f) / e)
    s = _share((b * t - c) / a)
    return p2 + t * other - p1 - s * along


def _share(value: Any) -> Any:
    return ca.fmin(ca.fmax(value, 0), 1)


def margin_of(ball: LinkBall, touching: Sequence[str]) -> str | None:
    """Which margin a ball keeps from the object; None for the pads of the fingers that touch it."""
    touches = ball.finger in touching
    if ball.is_pad and touches:
        return None
    return "clear_tip" if ball.on_tip and touches else "clear_object"


def moving(hand: Hand, balls: tuple[LinkBall, ...]) -> tuple[LinkBall, ...]:
    """The balls that move with q or the base: not those of an arm's root, which stands fixed."""
    return tuple(b for b in balls if hand.arm is None or b.joint_id > 0)


def link_balls(hand: Hand) -> tuple[LinkBall, ...]:
    """Balls that fill every colliding geometry of a hand."""
    return _distinct(hand, _balls(hand, corners=False))


def hull_balls(hand: Hand) -> tuple[LinkBall, ...]:
    """Balls whose convex hull, joint by joint, holds every link: for clearance from a plane."""
    balls = _balls(hand, corners=True)
    inner: set[int] = set()
    for joint in {b.joint_id for b in balls}:
        points = [i for i, b in enumerate(balls) if b.joint_id == joint and b.radius == 0]
        if len(points) > 4:
            hull = ConvexHull([balls[i].center for i in points])
            inner |= set(points) - {points[k] for k in hull.vertices}
    return _distinct(hand, [b for i, b in enumerate(balls) if i not in inner])


def _balls(hand: Hand, *, corners: bool) -> list[LinkBall]:
    out = []
    for geometry in hand.geometries:
        name = hand.finger_of_body.get(geometry.body, "")
        if corners:
            centers, radius = span(geometry)
            radii = np.full(len(centers), radius)
        else:
            bar = bool(name) and is_bar(hand, geometry, name)
            centers, radii = fill(geometry, slender=bar)
            if bar:
                # beside a contact the corners matter
                edges = span(geometry)[0]
                centers, radii = np.vstack([centers, edges]), np.append(radii, np.zeros(len(edges)))
        for center, radius in zip(centers, radii, strict=True):
            at = np.array(geometry.T_joint_geometry.act(center))
            out.append(_ball(hand, geometry, name, at, float(radius)))
    return out


def on_tip(hand: Hand, geometry: LinkGeometry, finger: str) -> bool:
    """Whether a geometry moves with the link that carries a finger's pad."""
    return bool(geometry.joint_id == hand.fingers[finger].pad.joint_id)


def is_bar(hand: Hand, geometry: LinkGeometry, finger: str) -> bool:
    """Whether a geometry of a finger is a box that reaches far: a long one, or that of the tip."""
    if geometry.kind != "box":
        return False
    _, wide, long = np.sort(geometry.size)
    return bool(long >= LONG * wide) or on_tip(hand, geometry, finger)


LONG = 1.5
"""Length over width from which a box is a bar and not a knuckle (-)."""


def _distinct(hand: Hand, balls: list[LinkBall]) -> tuple[LinkBall, ...]:
    """Without balls that lie in another one at every q: links that meet in a joint share an end."""
    rng = np.random.default_rng(0)
    far = np.zeros((len(balls), len(balls)))
    for _ in range(2):
        state = HandState(hand, rng.uniform(hand.q_lower, hand.q_upper))
        at = np.array([state.joint_pose(b.joint_id).act(b.center) for b in balls])
        far = np.maximum(far, np.linalg.norm(at[:, None] - at[None], axis=2))
    radius = np.array([b.radius for b in balls])
    inside = far + radius[:, None] <= radius[None] + SAME_POINT  # [i, j]: ball i is within ball j
    order = np.arange(len(balls))
    twins = inside & inside.T & (order[:, None] < order[None])  # of equal balls the first stays
    pads = np.array([b.is_pad for b in balls])
    dropped = ((inside & ~inside.T) | twins.T).any(axis=1) & ~pads
    return tuple(b for b, drop in zip(balls, dropped, strict=True) if not drop)


SAME_POINT = 1e-6
"""Distance (m) below which two points are one."""


@dataclass(frozen=True, kw_only=True)
class LinkBone:
    """A capsule along a finger's link: the points within ``radius`` of a segment.

    Attributes:
        finger: Name of the finger.
        joint_id: Pinocchio joint it moves with.
        inner: End of the segment nearer to the joint, (3,), m, in the joint's frame.
        outer: The other end; equal to ``inner`` for a ball.
        radius: m.
    """

    finger: str
    joint_id: int
    inner: FloatArray
    outer: FloatArray
    radius: float


def finger_bones(hand: Hand) -> tuple[LinkBone, ...]:
    """A bone for every geometry on the last three joints of every finger."""
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
        centers, radius = _bone(hand, g, name)
        ends = [np.array(g.T_joint_geometry.act(c)) for c in (centers[0], centers[-1])]
        ends.sort(key=lambda end: float(np.linalg.norm(end)))
        out.append(
            LinkBone(finger=name, joint_id=g.joint_id, inner=ends[0], outer=ends[1], radius=radius)
        )
    return tuple(out)


@lru_cache(maxsize=8)
def bones_are_true(hand: Hand) -> bool:
    """Whether the bones of all fingers are their links' true surfaces: spheres and capsules."""
    fingers = hand.finger_of_body
    return all(g.kind in ("sphere", "capsule") for g in hand.geometries if g.body in fingers)


def _bone(hand: Hand, geometry: LinkGeometry, finger: str) -> tuple[FloatArray, float]:
    """Ends (2, 3), m, of a bone, and its radius (m): of bars, half width to half diagonal."""
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
def meeting_bones(hand: Hand) -> tuple[tuple[int, int], ...]:
    """Pairs (i, j), i < j, of ``finger_bones`` of different fingers that can meet.

    Found by sampling the joint ranges: most pairs of fingers that are not neighbours never meet.
    What sampling misses, the verdict on the true geometry catches.
    """
    bones = finger_bones(hand)
    pairs = [
        (i, j) for i, j in combinations(range(len(bones)), 2) if bones[i].finger != bones[j].finger
    ]
    first, second = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
    joint = np.array([b.joint_id for b in bones])
    ends = np.array([[b.inner, b.outer] for b in bones])  # (n_bones, 2, 3)
    radius = np.array([b.radius for b in bones])
    least = radius[first] + radius[second] + MEETING_MARGIN
    matrix, value = hand.coupling_matrix
    project = np.linalg.pinv(matrix) if len(value) else np.zeros((hand.nq, 0))
    rng = np.random.default_rng(0)
    times = np.zeros(len(pairs), dtype=int)
    for _ in range(MEETING_SAMPLES):
        q = rng.uniform(hand.q_lower, hand.q_upper)
        q = np.clip(q - project @ (matrix @ q - value), hand.q_lower, hand.q_upper)
        poses = HandState(hand, q).pin_data.oMi
        turn = np.array([pose.rotation for pose in poses])[joint]
        shift = np.array([pose.translation for pose in poses])[joint]
        at = np.einsum("nij,nkj->nki", turn, ends) + shift[:, None]
        one, other = closest_on_segments(at[first, 0], at[first, 1], at[second, 0], at[second, 1])
        times += np.linalg.norm(other - one, axis=1) < least
    meets = times >= OFTEN * MEETING_SAMPLES
    return tuple((int(i), int(j)) for i, j in zip(first[meets], second[meets], strict=True))


def closest_on_segments(
    p1: FloatArray, q1: FloatArray, p2: FloatArray, q2: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Nearest points (k, 3) on segments p1 q1 and on p2 q2, as ``between_segments``."""
    along, other, apart = q1 - p1, q2 - p2, p1 - p2
    a = np.maximum((along * along).sum(axis=1), BALL_LENGTH**2)
    e = np.maximum((other * other).sum(axis=1), BALL_LENGTH**2)
    b, c = (along * other).sum(axis=1), (along * apart).sum(axis=1)
    f = (other * apart).sum(axis=1)
    s = np.clip((b * f - c * e) / np.maximum(a * e - b * b, PARALLEL * a * e), 0.0, 1.0)
    t = np.clip((b * s + f) / e, 0.0, 1.0)
    s = np.clip((b * t - c) / a, 0.0, 1.0)
    return p1 + s[:, None] * along, p2 + t[:, None] * other


OFTEN = 0.01
"""Share of random configurations in which two bones must meet to be kept apart in the NLP: rarer
ones cost more in every iteration than they spare in refused candidates."""

MEETING_SAMPLES = 400
"""Random configurations looked at by ``meeting_bones``; a fixed seed makes the NLP reproducible."""

MEETING_MARGIN = 0.005
"""Distance (m) below which two bones count as meeting: the clearance, and what few samples miss."""

BALL_LENGTH = 1e-6
"""Length (m) below which a bone is a ball."""

PARALLEL = 1e-9
"""Squared sine below which two segments are parallel (-)."""


def _ball(
    hand: Hand, geometry: LinkGeometry, finger: str, center: FloatArray, radius: float
) -> LinkBall:
    is_pad = tip = False
    if finger:
        pad = hand.fingers[finger].pad
        tip = on_tip(hand, geometry, finger)
        apart = float(np.linalg.norm(center - pad.center))
        is_pad = tip and apart < _PAD_OVERLAP
        if tip and pad_geometry(hand, pad.geom).kind not in ROUND:
            # the pad's sphere is a part of a box or a hull: balls that share room with it may touch
            is_pad = apart < radius + pad.radius
    return LinkBall(
        geometry=geometry.name,
        finger=finger,
        joint_id=geometry.joint_id,
        center=center,
        radius=radius,
        is_pad=is_pad,
        on_tip=tip,
    )
