"""A motion as weighted residuals with their Jacobian, for Levenberg-Marquardt steps.

The residuals of a grasp are evaluated once for every knot; their derivatives by the knot's base
pose are carried on to what all knots share. Units and weights are those of a grasp: a millimetre is
one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from planner.motion.jacobian import Block, MotionJacobian
from planner.motion.problem import MotionNumbers, MotionProblem
from planner.motion.unknowns import SHARE, SHARED, TUBE
from planner.numerics.casadi_buffers import BufferedFunction
from planner.spatial import FloatArray, IntArray
from planner.synthesis.nlp import Field
from planner.system.stage_times import stage

__all__ = ["PER_METRE", "PULL", "MotionResiduals", "Tally"]

PER_METRE = 1e3
"""A millimetre of sliding, or beyond the tube, is one unit of residual."""

PULL = 4.0
"""Residual of one radian, or of 35 mm (a fingertip's way in that), that is missing of the path. It
makes a radian worth some 0.1 mm of violation, which the last descent takes back."""

LEVER = 0.035
"""Distance (m) of a contact from the axis that makes a shift comparable to a turn."""


@dataclass(frozen=True, kw_only=True)
class Tally:
    """How many rows of the residuals belong to what, in their order.

    Attributes:
        avoided: Of each knot, which clearances are violated: numbers of their terms.
        terms: Of each knot, how many other rows count.
        rolling: Sliding.
        tube: Knots outside the tube.
        holds: Of each hold, how many rows count.
        loads: What bears too much: knot and number (k, 2), actuators of fingers before contacts.
    """

    avoided: tuple[IntArray, ...]
    terms: tuple[int, ...]
    rolling: int
    tube: int
    holds: tuple[int, ...]
    loads: IntArray


class MotionResiduals:
    """Weighted residuals r(z) that count, (m,), and their Jacobian (m, n): terms, then costs.

    Attributes:
        n_terms: After a call: how many of the first rows belong to terms.
        pull: Residual per unit of the path's share that is missing; 0 for none.
        grasped: Of every knot the residuals of its grasp.
    """

    def __init__(self, problem: MotionProblem, numbers: MotionNumbers, field: Field | None) -> None:
        """Bind a problem to numbers, and to the distance field of a mesh.

        What belongs to single knots is taken over here; later changes of it are not seen.
        """
        self.problem, self.numbers = problem, numbers
        self.n_terms = 0
        self.pull = 0.0
        self.grasped = tuple(problem.grasp.residuals.twin() for _ in numbers.knots)
        for one, p in zip(self.grasped, numbers.knots, strict=True):
            one.bind(p, field)
        self._bends = self._steady()

    @property
    def length(self) -> float:
        """Length of the whole path in units of ``PULL``."""
        n = self.numbers
        return abs(n.angle) + float(np.linalg.norm(n.shift)) / LEVER

    def knots(self, z: FloatArray) -> list[tuple[FloatArray, FloatArray]]:
        """Of every knot its unknowns as a grasp (size,), and the derivative (6, 10) of the first 6.

        The derivative is by what all knots share and by the place in the tube.
        """
        u, n = self.problem.unknowns, self.numbers
        shared = np.broadcast_to(z[:SHARED], (u.n_knots, SHARED))
        bases, slopes = self.problem.placement(
            np.hstack([shared, u.offsets(z)]),
            n.reference.T.ravel(),
            n.axis,
            n.angle,
            n.shift,
            n.places[:, None],
        )
        width, x = SHARED + TUBE, np.hstack([bases, u.rests(z)])
        rates = slopes.copy()
        return [(x[k], rates[width * k : width * (k + 1)].T) for k in range(u.n_knots)]

    def grasps(self, z: FloatArray) -> FloatArray:
        """Unknowns (n_knots, size) of every knot as a grasp."""
        return np.array([x for x, _ in self.knots(z)])

    def tally(self, z: FloatArray) -> Tally:
        """What the rows at z are about."""
        avoided, counted = [], []
        for one, (x, _) in zip(self.grasped, self.knots(z), strict=True):
            one(x)
            violated = one.avoided
            avoided.append(violated)
            counted.append(one.n_terms - len(violated))
        u = self.problem.unknowns
        return Tally(
            avoided=tuple(avoided),
            terms=tuple(counted),
            rolling=3 * u.grasp.n_contacts * (u.n_knots - 1),
            tube=sum(len(block.values) for block in self._tube(z)),
            holds=tuple(len(self._hold(h, z).values) for h in range(u.n_holds)),
            loads=np.argwhere(self._spare(self.knots(z))[0] < 0.0),
        )

    def __call__(self, x: FloatArray) -> tuple[FloatArray, MotionJacobian]:
        """Those that count at the unknowns x."""
        with stage("residuals"):
            return self._evaluate(x)

    def _evaluate(self, z: FloatArray) -> tuple[FloatArray, MotionJacobian]:
        u = self.problem.unknowns
        terms: list[Block] = []
        costs: list[Block] = []
        placed = self.knots(z)
        for k, (one, (x, slope)) in enumerate(zip(self.grasped, placed, strict=True)):
            r, local = one(x)
            rows = Block(values=r, rows=_carried(local, slope), at=u.columns(k))
            terms.append(rows.head(one.n_terms))
            costs.append(rows.tail(one.n_terms))
        terms += self._stepwise(self.problem.rolling, PER_METRE, placed)
        terms += self._tube(z)
        if self.numbers.pivot:
            costs += self._stepwise(self.problem.pivoting, self.numbers.pivot, placed)
        terms += [self._hold(h, z) for h in range(len(self.problem.holds))]
        terms += self._loads(placed)
        costs += [
            replace(block, values=block.rows[:, SHARED:] @ z[block.at]) for block in self._bends
        ]
        if self.pull:
            row = np.zeros((1, SHARED))
            row[0, SHARE] = -self.pull
            # a term: as long as much of the path is missing, a descent goes on
            missing = np.array([self.pull * (1.0 - z[SHARE])])
            terms.append(Block(values=missing, rows=row, at=slice(SHARED, SHARED)))
        self.n_terms = sum(len(block.values) for block in terms)
        blocks = terms + costs
        return np.concatenate([b.values for b in blocks]), MotionJacobian(blocks, u.size)

    def _stepwise(
        self, function: BufferedFunction, weight: float, placed: list[tuple[FloatArray, FloatArray]]
    ) -> list[Block]:
        """Rows of a function of every two neighbouring knots."""
        u = self.problem.unknowns
        x = np.array([x for x, _ in placed])
        values, slopes = function(x[:-1], x[1:], self.numbers.reference.T.ravel())
        values, slopes = weight * values, weight * slopes
        size = u.grasp.size
        out = []
        for k, mine in enumerate(values):
            local = slopes[2 * size * k : 2 * size * (k + 1)].T
            before = _carried(local[:, :size], placed[k][1])
            after = _carried(local[:, size:], placed[k + 1][1])
            both = before[:, :SHARED] + after[:, :SHARED]
            rows = np.hstack([both, before[:, SHARED:], after[:, SHARED:]])
            at = slice(u.columns(k).start, u.columns(k + 1).stop)
            out.append(Block(values=mine, rows=rows, at=at))
        return out

    def _spare(self, placed: list[tuple[FloatArray, FloatArray]]) -> tuple[FloatArray, FloatArray]:
        """What is to spare at each knot (n_knots, k), and its Jacobian (n_knots size, k)."""
        n = self.numbers
        x = np.array([x for x, _ in placed])
        spare, slopes = self.problem.loads(x, n.reference.T.ravel(), n.loads)
        return spare, slopes

    def _loads(self, placed: list[tuple[FloatArray, FloatArray]]) -> list[Block]:
        """What bears more than it may, knot by knot."""
        u = self.problem.unknowns
        spare, slopes = self._spare(placed)
        size = u.grasp.size
        out = []
        for k, mine in enumerate(spare):
            over = np.flatnonzero(mine < 0.0)
            if len(over):
                local = slopes[size * k : size * (k + 1), over].T
                rows = _carried(local, placed[k][1])
                out.append(Block(values=mine[over], rows=rows, at=u.columns(k)))
        return out

    def _hold(self, h: int, z: FloatArray) -> Block:
        """What hold h asks for."""
        problem, n = self.problem, self.numbers
        u, hold = problem.unknowns, problem.holds[h]
        n_contacts = u.grasp.n_contacts
        others = [j for j in range(n_contacts) if j != hold.lifted]
        knots = [hold.knots[j] % u.n_knots for j in others]
        p = problem.grasp.formulation.unpack(n.knots[0])
        shares = n.places[knots] * z[SHARE]
        first = TUBE + u.grasp.n_joints
        columns = np.concatenate(
            [
                np.arange(3) + u.columns(k).start + first + 3 * j
                for j, k in zip(others, knots, strict=True)
            ]
        )
        mine = np.arange(u.size)[u.hold_columns(h)]
        values, slopes = problem.hold_rows(
            z[columns].reshape(-1, 3),
            z[mine].reshape(-1, 3),
            shares,
            (n.axis, n.angle, n.shift),
            p,
            p["codes"].reshape(n_contacts, -1)[others],
        )
        rows = np.zeros((len(values), u.size))
        own = 6 * len(others)
        rows[:, np.concatenate([columns, mine])] = slopes[:, :own]
        rows[:, SHARE] += slopes[:, own:] @ n.places[knots]
        return Block(values=values, rows=rows, at=slice(SHARED, u.size))

    def _steady(self) -> list[Block]:
        """Rows by which joints are asked to go evenly: their second differences over the knots."""
        u, hand = self.problem.unknowns, self.problem.grasp.hand
        span = np.maximum(hand.q_upper - hand.q_lower, SMALLEST_RANGE)
        joints = np.arange(u.grasp.n_joints)
        rows = np.zeros((len(joints), SHARED + 3 * u.own))
        for step, weight in enumerate((1.0, -2.0, 1.0)):
            rows[joints, SHARED + step * u.own + TUBE + joints] = weight * STEADY / span
        return [
            Block(
                values=np.zeros(len(joints)),
                rows=rows,
                at=slice(u.columns(k - 1).start, u.columns(k + 1).stop),
            )
            for k in range(1, u.n_knots - 1)
        ]

    def _tube(self, z: FloatArray) -> list[Block]:
        """Knots that are further from the path than the tube is wide."""
        u = self.problem.unknowns
        offsets = u.offsets(z)
        far = np.linalg.norm(offsets, axis=1)
        out = []
        for k in np.flatnonzero(far > max(self.numbers.tube, LEAST_TUBE)).tolist():
            rows = np.zeros((1, SHARED + u.own))
            rows[0, SHARED : SHARED + TUBE] = -PER_METRE * offsets[k] / far[k]
            beyond = np.array([PER_METRE * (self.numbers.tube - far[k])])
            out.append(Block(values=beyond, rows=rows, at=u.columns(k)))
        return out


def _carried(local: FloatArray, slope: FloatArray) -> FloatArray:
    """Derivatives (m, size) by one knot's grasp unknowns, by what is shared and the knot's own.

    Args:
        local: By the grasp's unknowns, of which the first 6 place the base.
        slope: Of those (6, 10), by what is shared and by the place in the tube.
    """
    return np.hstack([local[:, :6] @ slope, local[:, 6:]])


STEADY = 1.0
"""Residual of a second difference of a joint by its whole range: fingers with joints to spare would
take another posture at every knot."""

SMALLEST_RANGE = 1e-3
"""Least range (rad or m) of a joint, so that a share of it is a number."""

LEAST_TUBE = 1e-9
"""Offset (m) from the path that is none."""
