"""Capsules of different fingers keep apart: the term ``fingers``, in NumPy and in compiled loops.

Capsules stand for the links of fingers (``planner.synthesis.link_capsules``), and pairs of them
that can meet have a row. Derivatives are computed for the violated ones alone.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from planner.numerics.kernels import loops_of_kernels
from planner.spatial import FloatArray, IntArray
from planner.synthesis.link_capsules import (
    PARALLEL,
    POINT_LENGTH,
    between_segments,
    closest_on_segments,
    collision_pairs,
    finger_capsules,
    rooms_at_rest,
)
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
