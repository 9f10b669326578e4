"""A motion as weighted residuals with their Jacobian: what ``planner.synthesis.descent`` descends.

The residuals of a grasp are evaluated once for every knot; their derivatives by the knot's base
pose are carried on to what all knots share. Units and weights are those of a grasp: a millimetre is
one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planner.motion.problem import MotionNumbers, MotionProblem
from planner.motion.unknowns import SHARE, SHARED, TUBE
from planner.spatial import FloatArray, IntArray
from planner.stages import stage
from planner.synthesis.buffered import BufferedFunction
from planner.synthesis.nlp import Field

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
    """

    def __init__(self, problem: MotionProblem, numbers: MotionNumbers, field: Field | None) -> None:
        """Bind a problem to numbers, and to the distance field of a mesh."""
        self.problem, self.numbers, self._field = problem, numbers, field
        self.n_terms = 0
        self.pull = 0.0
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
        one = self.problem.grasp.residuals
        avoided, counted = [], []
        for k, (x, _) in enumerate(self.knots(z)):
            one.bind(self.numbers.knots[k], self._field)
            one(x)
            violated = self.problem.avoidance(x).terms
            avoided.append(violated)
            counted.append(one.n_terms - len(violated))
        u = self.problem.unknowns
        return Tally(
            avoided=tuple(avoided),
            terms=tuple(counted),
            rolling=3 * u.grasp.n_contacts * (u.n_knots - 1),
            tube=len(self._tube(z)[0]),
            holds=tuple(len(self._hold(h, z)[0]) for h in range(u.n_holds)),
            loads=np.argwhere(self._spare(self.knots(z))[0] < 0.0),
        )

    def __call__(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Those that count at the unknowns x."""
        with stage("residuals"):
            return self._evaluate(x)

    def _evaluate(self, z: FloatArray) -> tuple[FloatArray, FloatArray]:
        u, one = self.problem.unknowns, self.problem.grasp.residuals
        terms: list[tuple[FloatArray, FloatArray]] = []
        costs: list[tuple[FloatArray, FloatArray]] = []
        placed = self.knots(z)
        for k, (x, slope) in enumerate(placed):
            one.bind(self.numbers.knots[k], self._field)
            r, local = one(x)
            rows = np.zeros((len(r), u.size))
            self._spread(rows, local, slope, k)
            n = one.n_terms
            terms.append((r[:n], rows[:n]))
            costs.append((r[n:], rows[n:]))
        terms += [self._stepwise(self.problem.rolling, PER_METRE, placed), self._tube(z)]
        if self.numbers.pivot:
            costs.append(self._stepwise(self.problem.pivoting, self.numbers.pivot, placed))
        terms += [self._hold(h, z) for h in range(len(self.problem.holds))]
        terms.append(self._loads(placed))
        costs.append((self._bends @ z, self._bends))
        if self.pull:
            row = np.zeros((1, u.size))
            row[0, SHARE] = -self.pull
            # a term: as long as much of the path is missing, a descent goes on
            terms.append((np.array([self.pull * (1.0 - z[SHARE])]), row))
        self.n_terms = sum(len(r) for r, _ in terms)
        parts = terms + costs
        return np.concatenate([r for r, _ in parts]), np.vstack([rows for _, rows in parts])

    def _spread(self, rows: FloatArray, local: FloatArray, slope: FloatArray, k: int) -> None:
        """Add derivatives (m, size) by one knot's grasp unknowns to rows (m, n)."""
        carried = local[:, :6] @ slope
        at = self.problem.unknowns.columns(k)
        rows[:, :SHARED] += carried[:, :SHARED]
        rows[:, at.start : at.start + TUBE] += carried[:, SHARED:]
        rows[:, at.start + TUBE : at.stop] += local[:, 6:]

    def _stepwise(
        self, function: BufferedFunction, weight: float, placed: list[tuple[FloatArray, FloatArray]]
    ) -> tuple[FloatArray, FloatArray]:
        """Rows of a function of every two neighbouring knots."""
        u = self.problem.unknowns
        x = np.array([x for x, _ in placed])
        values, slopes = function(x[:-1], x[1:], self.numbers.reference.T.ravel())
        m, size = values.shape[1], u.grasp.size
        rows = np.zeros((m * (u.n_knots - 1), u.size))
        for k in range(u.n_knots - 1):
            mine = rows[k * m : (k + 1) * m]
            local = slopes[2 * size * k : 2 * size * (k + 1)].T
            self._spread(mine, local[:, :size], placed[k][1], k)
            self._spread(mine, local[:, size:], placed[k + 1][1], k + 1)
        return weight * values.ravel(), weight * rows

    def _spare(self, placed: list[tuple[FloatArray, FloatArray]]) -> tuple[FloatArray, FloatArray]:
        """What is to spare at each knot (n_knots, k), and its Jacobian (n_knots size, k)."""
        n = self.numbers
        x = np.array([x for x, _ in placed])
        spare, slopes = self.problem.loads(x, n.reference.T.ravel(), n.loads)
        return spare, slopes

    def _loads(self, placed: list[tuple[FloatArray, FloatArray]]) -> tuple[FloatArray, FloatArray]:
        """What bears more than it may, knot by knot."""
        u = self.problem.unknowns
        spare, slopes = self._spare(placed)
        size = u.grasp.size
        values, rows = [np.zeros(0)], [np.zeros((0, u.size))]
        for k, mine in enumerate(spare):
            over = np.flatnonzero(mine < 0.0)
            if len(over):
                added = np.zeros((len(over), u.size))
                local = slopes[size * k : size * (k + 1), over].T
                self._spread(added, local, placed[k][1], k)
                values.append(mine[over])
                rows.append(added)
        return np.concatenate(values), np.vstack(rows)

    def _hold(self, h: int, z: FloatArray) -> tuple[FloatArray, FloatArray]:
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
        return values, rows

    def _steady(self) -> FloatArray:
        """Rows by which joints are asked to go evenly: their second differences over the knots."""
        u, hand = self.problem.unknowns, self.problem.grasp.hand
        span = np.maximum(hand.q_upper - hand.q_lower, SMALLEST_RANGE)
        rows = np.zeros((max(u.n_knots - 2, 0), u.grasp.n_joints, u.size))
        joints = np.arange(u.grasp.n_joints)
        for k in range(1, u.n_knots - 1):
            for neighbour, weight in ((k - 1, 1.0), (k, -2.0), (k + 1, 1.0)):
                at = u.columns(neighbour).start + TUBE + joints
                rows[k - 1, joints, at] = weight * STEADY / span
        return rows.reshape(-1, u.size)

    def _tube(self, z: FloatArray) -> tuple[FloatArray, FloatArray]:
        u = self.problem.unknowns
        offsets = u.offsets(z)
        far = np.linalg.norm(offsets, axis=1)
        out = np.flatnonzero(far > max(self.numbers.tube, LEAST_TUBE))
        rows = np.zeros((len(out), u.size))
        for row, k in zip(rows, out, strict=True):
            at = u.columns(int(k)).start
            row[at : at + TUBE] = -offsets[k] / far[k]
        return PER_METRE * (self.numbers.tube - far[out]), PER_METRE * rows


STEADY = 1.0
"""Residual of a second difference of a joint by its whole range: fingers with joints to spare would
take another posture at every knot."""

SMALLEST_RANGE = 1e-3
"""Least range (rad or m) of a joint, so that a share of it is a number."""

LEAST_TUBE = 1e-9
"""Offset (m) from the path that is none."""
