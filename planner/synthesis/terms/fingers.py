"""Capsules of different fingers keep apart: the term ``fingers``, in NumPy and in compiled loops.

Capsules along the last three links stand for a finger, and pairs of them that can meet at all have
a row. Derivatives are computed for the violated ones alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from planner.bridge import LinkGeometry
from planner.hands.hand import Hand
from planner.kinematics import HandState, MovingHand
from planner.numerics.kernels import loops_of_kernels
from planner.spatial import FloatArray, IntArray
from planner.synthesis.link_spheres import fill, span
from planner.synthesis.mesh_surface import Field
from planner.synthesis.symbols import GraspSymbols
from planner.synthesis.terms.hand_points import (
    HandAt,
    HandPoints,
    Joints,
    Rows,
    end_row,
    move,
    side_by_side,
)
from planner.synthesis.terms.standard import PER_METRE
from planner.synthesis.terms.term import ActiveRows, Role, Row, RowSource, Term


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


FINGERS = Term(
    name="fingers",
    meaning="squared distance of link capsules less that of touching with clear_fingers between",
    role=Role.INEQUALITY,
    unit="m2",
    weight=PER_METRE / 0.03,  # two links are some 15 mm apart
    wording="clearance between {}",
    judged="penetration of the true links",
    lacking="the fingers stand in each other's way; fewer fingers, or a larger object",
)


class FingerCapsules(RowSource):
    """Distances between fingers of one hand.

    Attributes:
        capsules: Of all fingers.
        pairs: Those that avoid each other (n_pairs, 2).
    """

    def __init__(self, symbols: GraspSymbols) -> None:
        """Write the expressions.

        Args:
            symbols: Unknowns and parameters.
        """
        g = self._symbols = symbols
        self.capsules = finger_capsules(g.hand)
        self.pairs = np.array(collision_pairs(g.hand), dtype=np.int64).reshape(-1, 2)
        self._points = HandPoints(g.hand, g.unknowns, [c.joint_id for c in self.capsules])
        point = g.symbolic.point
        self.outputs = {
            "inner": side_by_side([point(c.joint_id, c.inner) for c in self.capsules]),
            "outer": side_by_side([point(c.joint_id, c.outer) for c in self.capsules]),
            "rooms": ca.horzcat(*_between_fingers(g)),
            "columns": g.symbolic.joint_columns(),
        }

    @property
    def rows(self) -> dict[Term, tuple[Row, ...]]:
        """See ``RowSource``."""
        names = [c.finger for c in self.capsules]
        pairs = enumerate(self.pairs.tolist())
        return {FINGERS: tuple(FINGERS.row((names[i], names[j]), k) for k, (i, j) in pairs)}

    @property
    def expressions(self) -> dict[Term, Any]:
        """All rows (n_pairs,) as expressions."""
        return {FINGERS: self.outputs["rooms"].T}

    def set_parameters(self, values: dict[str, FloatArray], field: Field | None) -> None:
        """See ``RowSource``."""

    def squared_distances(self, values: dict[str, FloatArray]) -> FloatArray:
        """What the squared distance of each pair must be (n_pairs,), m2."""
        radii = np.array([c.radius for c in self.capsules])
        rooms, clear = rooms_at_rest(self._symbols.hand), float(values["clear_fingers"][0])
        least = np.maximum(radii[self.pairs].sum(axis=1) + np.minimum(clear, rooms), 0.0)
        out: FloatArray = least**2
        return out

    def __call__(self, x: FloatArray) -> list[ActiveRows]:
        """See ``RowSource``."""
        rooms = self._found["rooms"][:, 0]
        bad = np.flatnonzero(rooms < 0.0)
        if not len(bad):
            return []
        first, second = self.pairs[bad].T
        inner, outer = self._found["inner"], self._found["outer"]
        end, foot = closest_on_segments(inner[first], outer[first], inner[second], outer[second])
        twice, twists = 2.0 * (end - foot), self._found["columns"]
        rates = self._points.joint_rows(twists, first, end, twice)
        rates -= self._points.joint_rows(twists, second, foot, twice)
        rows = np.zeros((len(bad), self._symbols.unknowns.size))
        self._symbols.unknowns.q(rows.T)[:] = rates.T
        return [ActiveRows(FINGERS, rooms[bad], rows, bad)]


def _between_fingers(g: GraspSymbols) -> list[Any]:
    """Squared distance of capsules of different fingers, less the least allowed (m2)."""
    capsules = finger_capsules(g.hand)
    ends = [(g.place(c.joint_id, c.inner), g.place(c.joint_id, c.outer)) for c in capsules]
    corners = [ca.SX.sym(name, 3) for name in ("p1", "q1", "p2", "q2")]
    way = ca.Function("way", corners, [between_segments(*corners)])  # written once: 1 ms each
    out = []
    clear = g.option["clear_fingers"]
    for (i, j), room in zip(collision_pairs(g.hand), rooms_at_rest(g.hand), strict=True):
        apart = way(*ends[i], *ends[j])
        asked = ca.fmin(clear, float(room))
        least = ca.fmax(capsules[i].radius + capsules[j].radius + asked, 0.0)
        out.append(ca.sumsqr(apart) - least**2)
    return out


class CapsuleTables(NamedTuple):
    """Capsules of the fingers for compiled loops.

    Attributes:
        joint: Joint that each moves with (k,).
        ends: Inner ends, then outer ends, in its frame (2 k, 3), m.
        pairs: Which can meet (p, 2).
        place: Of the term, see ``Rows``.
    """

    joint: IntArray
    ends: FloatArray
    pairs: IntArray
    place: int


class CapsuleRun(NamedTuple):
    """Numbers of one task, and what is known at the last evaluation.

    Attributes:
        apart: What the squared distance of each pair must be (p,), m2.
        ends: In the frame of the base (2 k, 3), m.
        work: Nearest points, twice their difference, moment (4, 3).
        rates: Of the row in hand by the joints (nq,).
    """

    apart: FloatArray
    ends: FloatArray
    work: FloatArray
    rates: FloatArray


def capsule_tables(source: FingerCapsules, place: int) -> CapsuleTables:
    """The tables of a source."""
    ends = [c.inner for c in source.capsules] + [c.outer for c in source.capsules]
    return CapsuleTables(
        joint=np.array([c.joint_id for c in source.capsules], dtype=np.int64),
        ends=np.array(ends, dtype=np.float64).reshape(-1, 3),
        pairs=source.pairs,
        place=place,
    )


def capsule_run(source: FingerCapsules, values: dict[str, FloatArray], nq: int) -> CapsuleRun:
    """Numbers of a task, from parameters by name."""
    return CapsuleRun(
        apart=source.squared_distances(values),
        ends=np.zeros((2 * len(source.capsules), 3)),
        work=np.zeros((4, 3)),
        rates=np.zeros(nq),
    )


@loops_of_kernels
def finger_rows(t: CapsuleTables, run: CapsuleRun, p: Joints, hand: HandAt, rows: Rows) -> None:
    """Append the pairs of capsules that are too near."""
    work, count, weight = run.work, len(t.joint), rows.weights[t.place]
    for k in range(count):
        move(hand, t.joint[k], t.ends, k, run.ends)
        move(hand, t.joint[k], t.ends, count + k, run.ends)
    for k in range(len(t.pairs)):
        nearest(run.ends, t.pairs[k, 0], t.pairs[k, 1], count, work)
        room = -run.apart[k]
        for i in range(3):
            room += (work[1, i] - work[0, i]) ** 2
            work[2, i] = 2.0 * (work[0, i] - work[1, i])
        if room >= 0.0:
            continue
        rows.least[t.place] = min(rows.least[t.place], room)
        rates, twists = run.rates, hand.twists
        for j in range(len(rates)):
            rates[j] = 0.0
        for side in range(2):
            work[3, 0] = work[side, 1] * work[2, 2] - work[side, 2] * work[2, 1]
            work[3, 1] = work[side, 2] * work[2, 0] - work[side, 0] * work[2, 2]
            work[3, 2] = work[side, 0] * work[2, 1] - work[side, 1] * work[2, 0]
            joint = t.joint[t.pairs[k, side]]
            for c in range(p.chain_ends[joint], p.chain_ends[joint + 1]):
                j = p.chains[c]
                o = 6 * j
                along = (
                    twists[o] * work[2, 0] + twists[o + 1] * work[2, 1] + twists[o + 2] * work[2, 2]
                )
                turning = (
                    twists[o + 3] * work[3, 0]
                    + twists[o + 4] * work[3, 1]
                    + twists[o + 5] * work[3, 2]
                )
                rate = along + turning
                rates[j] += rate if side == 0 else -rate
        at = rows.filled[1]
        for j in range(len(rates)):
            if rates[j] != 0.0:
                rows.columns[at], rows.entries[at] = 6 + j, weight * rates[j]
                at += 1
        end_row(rows, weight * room, at)


@loops_of_kernels
def nearest(ends: FloatArray, one: int, two: int, count: int, out: FloatArray) -> None:
    """Nearest points of two capsules' segments into out (0 and 1), as ``closest_on_segments``."""
    a = b = c = e = f = 0.0
    for i in range(3):
        first, second = ends[count + one, i] - ends[one, i], ends[count + two, i] - ends[two, i]
        apart = ends[one, i] - ends[two, i]
        a += first * first
        b += first * second
        c += first * apart
        e += second * second
        f += second * apart
    a, e = max(a, POINT_LENGTH**2), max(e, POINT_LENGTH**2)
    s = min(max((b * f - c * e) / max(a * e - b * b, PARALLEL * a * e), 0.0), 1.0)
    t = min(max((b * s + f) / e, 0.0), 1.0)
    s = min(max((b * t - c) / a, 0.0), 1.0)
    for i in range(3):
        out[0, i] = ends[one, i] + s * (ends[count + one, i] - ends[one, i])
        out[1, i] = ends[two, i] + t * (ends[count + two, i] - ends[two, i])
