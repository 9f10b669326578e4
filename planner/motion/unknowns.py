"""Layout of the unknowns of a motion, and the pose of the base at each knot.

Unknowns: z = [s (3), t (3), share (1), then for each knot o (3), q, contact points, forces; then
the forces of stances (``planner.motion.terms``)].

The base stands still while the object moves. s and t place it in the middle frame, which has the
object's orientation half-way and its origin at the start, as in a grasp: base = R0 M(s), at t. The
object at knot k, at path parameter c in [0, 1] and with the path scaled by the unknown share,
is turned there by th = (c - 1/2) share angle about the axis a, and is off by d = c share R' shift
+ o, where o is its freedom within the path tolerance. In the object's own frame the base is then at

    R(a, -th) R0 M(s) = R0 M(s_k),    t_k = R(a, -th) (t - d),

and s_k, t_k, q, points and forces of one knot are the unknowns of a grasp
(``planner.synthesis.symbols``): every term of a grasp applies to every knot.

``MotionJacobian``: rows that depend on what all knots share and on one knot or two neighbours.

Kept as blocks. Least squares need J'J and J'r; of blocks they take a tenth of the time that the
product of the whole matrix takes, which has some 900 rows and 220 columns and is mostly zeros.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from planner.spatial import FloatArray
from planner.synthesis.symbols import Unknowns, mrp_matrix
from planner.synthesis.terms.term import Row
from planner.system.threads import made_once

SHARED = 7
"""Unknowns that all knots share: turn, shift, and the covered share of the path."""

SHARE = 6
"""Index of the covered share of the path."""

OFFSET = 3
"""Unknowns of a knot's offset from the path."""


@dataclass(frozen=True, kw_only=True)
class MotionUnknowns:
    """Layout of z.

    Attributes:
        grasp: Layout of one knot's unknowns as a grasp.
        n_knots: Number of knots.
        n_stances: Number of stances, each with the forces of all contacts but one.
    """

    grasp: Unknowns
    n_knots: int
    n_stances: int = 0

    @cached_property
    def own(self) -> int:
        """Unknowns of one knot alone: offset from the path, joints, points and forces."""
        return OFFSET + self.grasp.size - 6

    @property
    def size(self) -> int:
        """Length of z."""
        return self._end + self.n_stances * self.stance_size

    @property
    def stance_size(self) -> int:
        """Unknowns of one stance."""
        return 3 * (self.grasp.n_contacts - 1)

    @property
    def _end(self) -> int:
        return SHARED + self.n_knots * self.own

    def stance_columns(self, number: int) -> slice:
        """Where the forces of a stance stand in z."""
        return slice(
            self._end + number * self.stance_size, self._end + (number + 1) * self.stance_size
        )

    def pack(
        self, shared: FloatArray, offsets: FloatArray, rests: FloatArray, forces: FloatArray
    ) -> FloatArray:
        """One column of its parts: (7,), (n_knots, 3), [q, points, forces] of knots, stances."""
        return np.concatenate([shared, np.hstack([offsets, rests]).ravel(), forces.ravel()])

    def knots(self, z: FloatArray) -> FloatArray:
        """Rows (n_knots, own) of what belongs to one knot each; a view."""
        return z[SHARED : self._end].reshape(self.n_knots, self.own)

    def offsets(self, z: FloatArray) -> FloatArray:
        """Offsets from the path (n_knots, 3), m, middle frame; a view."""
        return self.knots(z)[:, :OFFSET]

    def rests(self, z: FloatArray) -> FloatArray:
        """[q, points, forces] of every knot (n_knots, grasp.size - 6); a view."""
        return self.knots(z)[:, OFFSET:]

    def columns(self, k: int) -> slice:
        """Where knot k stands in z."""
        return slice(SHARED + k * self.own, SHARED + (k + 1) * self.own)


@made_once(1)
def placement() -> Any:
    """CasADi function of [s, t, share, o], R0 (9, by columns), axis, angle, shift and c.

    Axis and shift are in the object's frame at the start. Gives [s_k, t_k] (6,) and its
    Jacobian (6, 10).
    """
    y, r0 = ca.SX.sym("y", SHARED + OFFSET), ca.SX.sym("R0", 3, 3)
    axis, angle, shift = ca.SX.sym("a", 3), ca.SX.sym("angle"), ca.SX.sym("d", 3)
    c = ca.SX.sym("c")
    s, t, share, offset = y[:3], y[3:6], y[SHARE], y[SHARED:]
    turn = (c - 0.5) * share * angle
    half = share * angle / 2
    away = c * share * (_rotation(axis, -half) @ shift) + offset
    back = _compose(*_quaternion(r0.T @ axis, -turn), *_of_mrp(s))
    out = ca.vertcat(back, _rotation(axis, -turn) @ (t - away))
    inputs = [y, ca.vec(r0), axis, angle, shift, c]
    return ca.Function("placement", inputs, [out, ca.densify(ca.jacobian(out, y))])


def _rotation(axis: Any, angle: Any) -> Any:
    """Rotation (3, 3) by an angle about a unit axis."""
    return mrp_matrix(axis * ca.tan(angle / 4))


def _quaternion(axis: Any, angle: Any) -> tuple[Any, Any]:
    return ca.cos(angle / 2), axis * ca.sin(angle / 2)


def _of_mrp(s: Any) -> tuple[Any, Any]:
    n = ca.dot(s, s)
    return (1 - n) / (1 + n), 2 * s / (1 + n)


def _compose(w1: Any, v1: Any, w2: Any, v2: Any) -> Any:
    """Modified Rodrigues parameters of the product of two unit quaternions."""
    w = w1 * w2 - ca.dot(v1, v2)
    v = w1 * v2 + w2 * v1 + ca.cross(v1, v2)
    return v / (1 + w)


@dataclass(frozen=True, kw_only=True)
class Block:
    """Some rows with the residuals that they are the derivatives of.

    Attributes:
        values: Residuals (m,).
        rows: Derivatives (m, SHARED + w): by what all knots share, then by the unknowns ``at``.
        at: Which w unknowns those are, after the shared ones.
        names: Tells the names of the rows (m).
    """

    values: FloatArray
    rows: FloatArray
    at: slice
    names: Callable[[], Sequence[Row]]

    def head(self, n: int) -> Block:
        """The first n rows."""
        return self._part(slice(n))

    def tail(self, n: int) -> Block:
        """All rows but the first n."""
        return self._part(slice(n, None))

    def _part(self, which: slice) -> Block:
        return Block(
            values=self.values[which],
            rows=self.rows[which],
            at=self.at,
            names=lambda: self.names()[which],
        )


class MotionJacobian:
    """A Jacobian (m, size) in blocks, one under the other."""

    def __init__(self, blocks: list[Block], size: int) -> None:
        """Keep the blocks, in their order, and the number of unknowns."""
        self._blocks, self._size = blocks, size

    def normal_equations(self) -> tuple[FloatArray, FloatArray]:
        """J'J (size, size) and J'r (size,) with the blocks' residuals."""
        normal, slope = np.zeros((self._size, self._size)), np.zeros(self._size)
        for block in self._blocks:
            if not len(block.values):
                continue
            product, pull = block.rows.T @ block.rows, block.values @ block.rows
            at = block.at
            normal[:SHARED, :SHARED] += product[:SHARED, :SHARED]
            normal[:SHARED, at] += product[:SHARED, SHARED:]
            normal[at, at] += product[SHARED:, SHARED:]
            slope[:SHARED] += pull[:SHARED]
            slope[at] += pull[SHARED:]
        normal[SHARED:, :SHARED] = normal[:SHARED, SHARED:].T
        return normal, slope

    def row_names(self) -> list[Row]:
        """The names of all rows, in their order."""
        return [row for block in self._blocks for row in block.names()]

    def dense(self) -> FloatArray:
        """The whole matrix (m, size)."""
        out = np.zeros((sum(len(b.values) for b in self._blocks), self._size))
        first = 0
        for block in self._blocks:
            mine = out[first : first + len(block.values)]
            mine[:, :SHARED], mine[:, block.at] = block.rows[:, :SHARED], block.rows[:, SHARED:]
            first += len(mine)
        return out
