"""Clearances as residuals where they count: what least squares sees of the links.

The same balls and bones as the NLP's terms (``planner.synthesis.clearance``), with the same
margins. Of some hundreds of clearances few are violated at a time. So CasADi computes the values of
all, and the places of all points; the derivatives of those that are violated are made from the
joints' Jacobians:

    point = R0 M(s) b(q) + t,     row = direction . (d point / d unknowns),
    d point / d s_k = R0 M(s) [rates_k x b],   d b / d q_k = v_k + omega_k x b,

with b a point of the base, or of the arm's last link, and rates as in ``mrp_rates``. On a mesh a
ball that was far from the object is not looked up again until it may have come near: distances
change no faster than points move.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from planner.hands.hand import Hand
from planner.shapes.surface import Surface, box_clearance
from planner.spatial import FloatArray, IntArray
from planner.synthesis.clearance import (
    LinkBall,
    closest_on_segments,
    finger_bones,
    margin_of,
    meeting_bones,
)
from planner.synthesis.gaps import Gaps
from planner.synthesis.nlp import Field
from planner.synthesis.terms import Formulation
from planner.synthesis.unknowns import mrp_rates

__all__ = ["TERMS", "Avoidance", "Violated"]

TERMS = ("object", "table", "obstacle", "fingers", "links")
"""Names of the terms, as in the NLP; ``links`` are those of ``planner.synthesis.gaps``."""

FASTEST = 1.1
"""Largest slope (-) of a mesh's smooth distance; a little more than that of the true one."""


@dataclass(frozen=True, kw_only=True)
class Violated:
    """Clearances that are violated.

    Attributes:
        values: (k,), negative, in the term's unit.
        rows: (k, n), their derivatives by the unknowns.
        terms: (k,), the number of the term in ``TERMS``.
    """

    values: FloatArray
    rows: FloatArray
    terms: IntArray


class _Points:
    """Points that move with joints: which joints' columns count for each."""

    def __init__(self, hand: Hand, joints: list[int]) -> None:
        moved = hand.moved_by[np.array(joints, dtype=np.int64)]
        self.moved = moved.reshape(len(joints), hand.nq).copy()
        # what the arm carries is placed by the unknowns s and t, its other links by its joints
        self.carried = np.ones((len(joints), 1), dtype=bool)
        if hand.arm is not None:
            self.carried = self.moved[:, hand.arm.chain[-1:]].copy()
            self.moved[np.ix_(self.carried[:, 0], hand.arm.chain)] = False


class Avoidance:
    """The clearances of one hand, finger set and kind of shape.

    Attributes:
        outputs: What is to be computed from the unknowns x and the parameters p, by name.
    """

    def __init__(self, formulation: Formulation, surface: Surface) -> None:
        """Write the expressions.

        Args:
            formulation: Unknowns, parameters, and the hand placed by them.
            surface: Form of the shape.
        """
        links = formulation.links
        hand = links.hand
        self._hand, self._surface, self._formulation = hand, surface, formulation
        self._balls = _Points(hand, [b.joint_id for b in links.balls])
        self._corners = _Points(hand, [b.joint_id for b in links.corners])
        self._bones = _Points(hand, [b.joint_id for b in finger_bones(hand)])
        self._pairs = np.array(meeting_bones(hand), dtype=np.int64).reshape(-1, 2)
        self._radii = np.array([b.radius for b in links.balls])
        self._avoids, self._on_tip = _avoiding(links.balls, formulation.finger_names)
        symbols = formulation.parameters
        values, slopes = ca.SX(1, 0), ca.SX(3, 0)
        if surface.field is None:
            values, slopes = _distances(links.centers, surface.clearance, symbols["size"])
        boxes = [
            _distances(links.centers, _from_box, ca.horzcat(*box))
            for box in formulation.surroundings.boxes
        ]
        bones = links.bones()
        self.outputs: dict[str, Any] = {
            "centers": _columns(links.centers),
            "balls": _columns([links.local(b) for b in links.balls]),
            "corners": _columns([links.local(b) for b in links.corners]),
            "inner": _columns([b[0] for b in bones]),
            "outer": _columns([b[1] for b in bones]),
            "distances": values,
            "slopes": slopes,
            "obstacle_distances": ca.vertcat(*[v for v, _ in boxes]),
            "obstacle_slopes": ca.horzcat(*[g for _, g in boxes]),
            "heights": ca.horzcat(
                *formulation.surroundings.from_table(links, symbols["clear_table"])
            ),
            "rooms": ca.horzcat(*links.between_fingers(symbols["clear_fingers"])),
            "columns": links.symbolic.joint_columns(),
            "rotation": links.rotation.T,
        }

    def receive(self, results: dict[str, FloatArray]) -> None:
        """Arrays that hold the transposed ``outputs`` after every evaluation, row by row."""
        self._found = results

    def bind(self, values: dict[str, FloatArray], field: Field | None) -> None:
        """Numbers for the calls that follow.

        Args:
            values: Parameters by name, see ``Formulation``.
            field: The distance field of a mesh.
        """
        self._values, self._field = values, field
        margin = np.where(self._on_tip, values["clear_tip"][0], values["clear_object"][0])
        self._reach = self._radii + margin + self._surface.distance_error
        self._reach[~self._avoids] = -np.inf
        self._seen = np.full((len(self._reach), 3), np.inf)
        self._gaps = np.where(self._avoids, -np.inf, np.inf)
        if self._hand.arm is not None:
            self._root = values["root"][:9].reshape(3, 3, order="F")
        self._kept: Gaps | None = None

    def keep(self, gaps: Gaps | None) -> None:
        """Clearances of the true geometry that count from now on, in place of those before."""
        self._kept = gaps

    def __call__(self, x: FloatArray) -> Violated:
        """What is violated at x, for which the outputs have been computed."""
        self._rates = mrp_rates(x[:3])
        parts = [*self._object(), *self._table(), *self._obstacles(), *self._fingers()]
        parts += self._links(x)
        if not parts:
            return Violated(values=_NONE, rows=np.zeros((0, len(x))), terms=_NONE.astype(np.int64))
        return Violated(
            values=np.concatenate([values for _, values, _ in parts]),
            rows=np.vstack([rows for _, _, rows in parts]),
            terms=np.repeat([k for k, _, _ in parts], [len(values) for _, values, _ in parts]),
        )

    def _rows(
        self, points: _Points, which: IntArray, at: FloatArray, directions: FloatArray
    ) -> FloatArray:
        """Derivatives (k, n) of points b (k, 3) along directions (k, 3) of the object's frame."""
        along = directions @ self._found["rotation"]
        out = np.zeros((len(which), self._formulation.unknowns.size))
        moments = _cross(at, along)
        out[:, :3], out[:, 3:6] = moments @ self._rates, directions
        if self._hand.arm is not None:
            carried = points.carried[which]
            out[:, :6] *= carried
            along = np.where(carried, along, directions @ self._root)
            moments = _cross(at, along)
        self._formulation.unknowns.q(out.T)[:] = self._turned(points, which, along, moments).T
        return out

    def _turned(
        self, points: _Points, which: IntArray, along: FloatArray, moments: FloatArray
    ) -> FloatArray:
        """Derivatives (k, nq) by the joints, of points that move along directions."""
        rates = np.hstack([along, moments]) @ self._found["columns"].T
        rates *= points.moved[which]
        return rates

    def _object(self) -> list[_Part]:
        if self._surface.field is None:
            gaps = self._found["distances"][:, 0] - self._reach
            bad = np.flatnonzero(gaps < 0.0)
            slopes = self._found["slopes"][bad]
        else:
            gaps, bad, slopes = self._looked_up()
        if not len(bad):
            return []
        return [(0, gaps[bad], self._rows(self._balls, bad, self._found["balls"][bad], slopes))]

    def _looked_up(self) -> tuple[FloatArray, IntArray, FloatArray]:
        """Gaps of all, as far as they are known, which ones are violated, and their gradients."""
        centers = self._found["centers"]
        moved = centers - self._seen
        moved *= moved
        near = np.flatnonzero(self._gaps < FASTEST * np.sqrt(moved.sum(axis=1)))
        if not len(near):
            return self._gaps, near, np.zeros((0, 3))
        assert self._field is not None
        found = self._field.taylor(centers[near], 1)
        self._seen[near] = centers[near]
        self._gaps[near] = found[:, 0] - self._reach[near]
        bad = self._gaps[near] < 0.0
        return self._gaps, near[bad], found[bad, 1:4]

    def _table(self) -> list[_Part]:
        heights = self._found["heights"][:, 0]
        bad = np.flatnonzero(heights < 0.0)
        if not len(bad):
            return []
        normals = np.tile(self._values["table"][:3], (len(bad), 1))
        rows = self._rows(self._corners, bad, self._found["corners"][bad], normals)
        return [(1, heights[bad], rows)]

    def _obstacles(self) -> list[_Part]:
        n = len(self._radii)
        slopes = self._found["obstacle_slopes"]
        parts: list[_Part] = []
        for k, gaps in enumerate(self._found["obstacle_distances"].T):
            room = gaps - self._radii - self._values["clear_table"][0]
            bad = np.flatnonzero(room < 0.0)
            if len(bad):
                at = self._found["balls"][bad]
                rows = self._rows(self._balls, bad, at, slopes[k * n + bad])
                parts.append((2, room[bad], rows))
        return parts

    def _fingers(self) -> list[_Part]:
        rooms = self._found["rooms"][:, 0]
        bad = np.flatnonzero(rooms < 0.0)
        if not len(bad):
            return []
        first, second = self._pairs[bad].T
        inner, outer = self._found["inner"], self._found["outer"]
        end, foot = closest_on_segments(inner[first], outer[first], inner[second], outer[second])
        twice = 2.0 * (end - foot)
        rates = self._turned(self._bones, first, twice, _cross(end, twice))
        rates -= self._turned(self._bones, second, twice, _cross(foot, twice))
        rows = np.zeros((len(bad), self._formulation.unknowns.size))
        self._formulation.unknowns.q(rows.T)[:] = rates.T
        return [(3, rooms[bad], rows)]

    def _links(self, x: FloatArray) -> list[_Part]:
        kept = self._kept
        if kept is None:
            return []
        values = kept.values + kept.rows @ (x - kept.x)
        bad = np.flatnonzero(values < -TIE)
        if not len(bad):
            return []
        return [(4, values[bad], kept.rows[bad])]


TIE = 1e-8
"""What lacks less than this (m) lacks nothing: steps end on what is linear, give or take rounding,
and rounding shall not say whether it counts."""


_Part = tuple[int, FloatArray, FloatArray]
"""Number of a term, values (k,), derivatives (k, n)."""

_NONE = np.zeros(0)


def _avoiding(
    balls: tuple[LinkBall, ...], touching: tuple[str, ...]
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which balls must stay away from the object, and which of them are beside a pad."""
    margins = [margin_of(b, touching) for b in balls]
    return np.array([m is not None for m in margins]), np.array([m == "clear_tip" for m in margins])


def _distances(
    points: list[Any], clearance: Callable[[Any, Any], Any], size: Any
) -> tuple[Any, Any]:
    """Distances (1, n) and gradients (3, n) of a clearance expression at points."""
    of, at = ca.SX.sym("of", size.shape), ca.SX.sym("at", 3)
    value = clearance(of, at)
    both = ca.Function("clearance", [of, at], [value, ca.gradient(value, at)])
    found = [both(size, p) for p in points]
    return ca.horzcat(*[v for v, _ in found]), ca.horzcat(*[g for _, g in found])


def _from_box(box: Any, point: Any) -> Any:
    """Clearance from a box: rotation (3, 3), translation (3,) and half extents (3,) in columns."""
    return box_clearance(box[:, 4], box[:, :3] @ point + box[:, 3])


def _columns(points: list[Any]) -> Any:
    return ca.horzcat(*points) if points else ca.SX(3, 0)


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Row by row, (k, 3); numpy's own takes five times as long on short arrays."""
    return a[:, NEXT] * b[:, AFTER] - a[:, AFTER] * b[:, NEXT]


NEXT, AFTER = np.array([1, 2, 0]), np.array([2, 0, 1])
