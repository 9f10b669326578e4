"""A motion as weighted residuals with their Jacobian, for Levenberg-Marquardt steps.

The residuals of a grasp are evaluated once for every knot. The chain rule turns their derivatives
by the knot's base pose into derivatives by the unknowns that all knots share. Units and weights are
those of a grasp: a millimetre is one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from planner.motion.problem import MotionNumbers, MotionProblem
from planner.motion.terms import (
    PATH,
    PIVOTING,
    REACH,
    ROLLING,
    STEADY,
    load_rows,
    rows_of_fingers,
    steady_rows,
    swing_rows,
)
from planner.motion.unknowns import OFFSET, SHARE, SHARED, Block, MotionJacobian
from planner.numerics.tape import BufferedFunction
from planner.spatial import FloatArray, IntArray
from planner.synthesis.mesh_surface import Field
from planner.synthesis.terms.term import Row, Term
from planner.system.threads import stage

LEVER = 0.035
"""Distance (m) of a contact from the axis that makes a shift comparable to a turn."""


class MotionResiduals:
    """Weighted residuals r(z) that count, (m,), and their Jacobian (m, n).

    Terms that must hold come first, then costs.

    Attributes:
        n_terms: After a call: how many of the first rows belong to terms that must hold.
        pull: Residual per missing share of the path; 0 for none.
        grasped: Of every knot the residuals of its grasp.
    """

    def __init__(self, problem: MotionProblem, numbers: MotionNumbers, field: Field | None) -> None:
        """Bind a problem to numbers, and to the distance field of a mesh.

        Parameters of single knots are copied; later changes of them have no effect.
        """
        self.problem, self.numbers = problem, numbers
        self.n_terms = 0
        self.pull = 0.0
        self.grasped = tuple(problem.grasp.residuals.clone() for _ in numbers.knots)
        for one, p in zip(self.grasped, numbers.knots, strict=True):
            one.set_parameters(p, field)
        self._second_differences = self._steady()

    @property
    def length(self) -> float:
        """Length of the whole path, rad; a shift counts over ``LEVER``."""
        n = self.numbers
        return abs(n.angle) + float(np.linalg.norm(n.shift)) / LEVER

    def knots(self, z: FloatArray) -> list[tuple[FloatArray, FloatArray]]:
        """Of every knot its unknowns as a grasp (size,), and the derivative (6, 10) of the first 6.

        The derivative is by the shared unknowns and by the offset from the path.
        """
        u, n = self.problem.unknowns, self.numbers
        shared = np.broadcast_to(z[:SHARED], (u.n_knots, SHARED))
        bases, slopes = self.problem.placement(
            np.hstack([shared, u.offsets(z)]),
            n.reference.T.ravel(),
            n.axis,
            n.angle,
            n.shift,
            n.path_parameters[:, None],
        )
        width, x = SHARED + OFFSET, np.hstack([bases, u.rests(z)])
        rates = slopes.copy()
        return [(x[k], rates[width * k : width * (k + 1)].T) for k in range(u.n_knots)]

    def grasps(self, z: FloatArray) -> FloatArray:
        """Unknowns (n_knots, size) of every knot as a grasp."""
        return np.array([x for x, _ in self.knots(z)])

    def row_names(self) -> list[Row]:
        """The names of the rows of the last call, in their order."""
        return self._jacobian.row_names()

    def __call__(self, x: FloatArray) -> tuple[FloatArray, MotionJacobian]:
        """The active residuals at the unknowns x, and their Jacobian."""
        with stage("residuals"):
            return self._evaluate(x)

    def _evaluate(self, z: FloatArray) -> tuple[FloatArray, MotionJacobian]:
        u = self.problem.unknowns
        terms: list[Block] = []
        costs: list[Block] = []
        placed = self.knots(z)
        for k, (one, (x, slope)) in enumerate(zip(self.grasped, placed, strict=True)):
            r, local = one(x)
            rows = Block(
                values=r,
                rows=_carried(local, slope),
                at=u.columns(k),
                names=partial(self._grasp_rows, k),
            )
            terms.append(rows.head(one.n_terms))
            costs.append(rows.tail(one.n_terms))
        terms += self._stepwise(self.problem.rolling, ROLLING, 3, placed)
        terms += self._off_path(z)
        if self.numbers.pivoting_costs:
            costs += self._stepwise(self.problem.pivoting, PIVOTING, 1, placed)
        terms += [self._stance(k, z) for k in range(len(self.problem.stances))]
        terms += self._loads(placed)
        costs += [
            replace(block, values=block.rows[:, SHARED:] @ z[block.at])
            for block in self._second_differences
        ]
        if self.pull:
            row = np.zeros((1, SHARED))
            row[0, SHARE] = -self.pull
            # a term, not a cost: least squares go on as long as much of the path is missing
            missing = np.array([self.pull * (1.0 - z[SHARE])])
            at = slice(SHARED, SHARED)
            terms.append(Block(values=missing, rows=row, at=at, names=_just(REACH.row())))
        self.n_terms = sum(len(block.values) for block in terms)
        blocks = terms + costs
        self._jacobian = MotionJacobian(blocks, u.size)
        return np.concatenate([b.values for b in blocks]), self._jacobian

    def _grasp_rows(self, k: int) -> list[Row]:
        return [replace(row, knot=k) for row in self.grasped[k].row_names()]

    def _stepwise(
        self,
        function: BufferedFunction,
        term: Term,
        each: int,
        placed: list[tuple[FloatArray, FloatArray]],
    ) -> list[Block]:
        """Rows of a function of every two neighbouring knots, ``each`` for every finger."""
        u = self.problem.unknowns
        x = np.array([x for x, _ in placed])
        values, slopes = function(x[:-1], x[1:], self.numbers.reference.T.ravel())
        values, slopes = term.weight * values, term.weight * slopes
        fingers = self.problem.grasp.fingers
        size = u.grasp.size
        out = []
        for k, mine in enumerate(values):
            local = slopes[2 * size * k : 2 * size * (k + 1)].T
            before = _carried(local[:, :size], placed[k][1])
            after = _carried(local[:, size:], placed[k + 1][1])
            both = before[:, :SHARED] + after[:, :SHARED]
            rows = np.hstack([both, before[:, SHARED:], after[:, SHARED:]])
            at = slice(u.columns(k).start, u.columns(k + 1).stop)
            names = partial(rows_of_fingers, term, fingers, each, k + 1)
            out.append(Block(values=mine, rows=rows, at=at, names=names))
        return out

    def _load_margins(
        self, placed: list[tuple[FloatArray, FloatArray]]
    ) -> tuple[FloatArray, FloatArray]:
        """Margins of loads at each knot (n_knots, k), and their Jacobian (n_knots size, k)."""
        n = self.numbers
        x = np.array([x for x, _ in placed])
        margins, slopes = self.problem.loads(x, n.reference.T.ravel(), n.loads)
        return margins, slopes

    def _loads(self, placed: list[tuple[FloatArray, FloatArray]]) -> list[Block]:
        """Actuators and contacts beyond their limits, knot by knot."""
        u = self.problem.unknowns
        margins, slopes = self._load_margins(placed)
        size = u.grasp.size
        out = []
        for k, mine in enumerate(margins):
            over = np.flatnonzero(mine < 0.0)
            if len(over):
                local = slopes[size * k : size * (k + 1), over].T
                rows = _carried(local, placed[k][1])
                names = partial(self._load_rows, k, over)
                out.append(Block(values=mine[over], rows=rows, at=u.columns(k), names=names))
        return out

    def _load_rows(self, k: int, which: IntArray) -> list[Row]:
        grasp = self.problem.grasp
        rows = load_rows(grasp.hand, grasp.fingers, k)
        return [rows[i] for i in which.tolist()]

    def _stance(self, number: int, z: FloatArray) -> Block:
        """Closure of a stance."""
        problem, n = self.problem, self.numbers
        u, stance = problem.unknowns, problem.stances[number]
        n_contacts = u.grasp.n_contacts
        others = [j for j in range(n_contacts) if j != stance.swinging]
        knots = [stance.knots[j] % u.n_knots for j in others]
        p = problem.grasp.formulation.unpack(n.knots[0])
        parameters = n.path_parameters[knots] * z[SHARE]
        first = OFFSET + u.grasp.n_joints
        columns = np.concatenate(
            [
                np.arange(3) + u.columns(k).start + first + 3 * j
                for j, k in zip(others, knots, strict=True)
            ]
        )
        mine = np.arange(u.size)[u.stance_columns(number)]
        values, slopes, which = problem.stance_rows(
            z[columns].reshape(-1, 3),
            z[mine].reshape(-1, 3),
            parameters,
            (n.axis, n.angle, n.shift),
            p,
            p["codes"].reshape(n_contacts, -1)[others],
        )
        rows = np.zeros((len(values), u.size))
        own = 6 * len(others)
        rows[:, np.concatenate([columns, mine])] = slopes[:, :own]
        rows[:, SHARE] += slopes[:, own:] @ n.path_parameters[knots]
        names = partial(self._swing_rows, stance.swinging, which)
        return Block(values=values, rows=rows, at=slice(SHARED, u.size), names=names)

    def _swing_rows(self, swinging: int, which: IntArray) -> list[Row]:
        rows = swing_rows(self.problem.grasp.fingers, swinging, self.problem.n_knots - 1)
        return [rows[i] for i in which.tolist()]

    def _steady(self) -> list[Block]:
        """Second differences of the joints over the knots: a cost of uneven motion."""
        u, hand = self.problem.unknowns, self.problem.grasp.hand
        span = np.maximum(hand.q_upper - hand.q_lower, SMALLEST_RANGE)
        joints = np.arange(u.grasp.n_joints)
        rows = np.zeros((len(joints), SHARED + 3 * u.own))
        for step, weight in enumerate((1.0, -2.0, 1.0)):
            rows[joints, SHARED + step * u.own + OFFSET + joints] = weight * STEADY.weight / span
        return [
            Block(
                values=np.zeros(len(joints)),
                rows=rows,
                at=slice(u.columns(k - 1).start, u.columns(k + 1).stop),
                names=partial(steady_rows, hand, k),
            )
            for k in range(1, u.n_knots - 1)
        ]

    def _off_path(self, z: FloatArray) -> list[Block]:
        """Knots that are beyond the path tolerance."""
        u = self.problem.unknowns
        offsets = u.offsets(z)
        far = np.linalg.norm(offsets, axis=1)
        out = []
        for k in np.flatnonzero(far > max(self.numbers.path_tolerance, LEAST_TOLERANCE)).tolist():
            rows = np.zeros((1, SHARED + u.own))
            rows[0, SHARED : SHARED + OFFSET] = -PATH.weight * offsets[k] / far[k]
            beyond = np.array([PATH.weight * (self.numbers.path_tolerance - far[k])])
            names = _just(PATH.row(number=k, knot=k))
            out.append(Block(values=beyond, rows=rows, at=u.columns(k), names=names))
        return out


def _just(row: Row) -> Callable[[], list[Row]]:
    """A function that names a single row."""
    return lambda: [row]


def _carried(local: FloatArray, slope: FloatArray) -> FloatArray:
    """Derivatives (m, size) by one knot's grasp unknowns, turned into shared ones and its own.

    Args:
        local: By the grasp's unknowns, of which the first 6 place the base.
        slope: Of those (6, 10), by the shared unknowns and the offset from the path.
    """
    return np.hstack([local[:, :6] @ slope, local[:, 6:]])


SMALLEST_RANGE = 1e-3
"""Least range (rad or m) of a joint, so that a share of it is a number."""

LEAST_TOLERANCE = 1e-9
"""Offset (m) from the path that counts as zero."""
