"""The objective epsilon: resistance of a grasp in its weakest directions of wrench.

A round of least squares works on up to ``N_DIRECTIONS`` directions; outside rounds there are none,
and no rows. The formula is ``support`` of ``planner.synthesis.symbols``, here in numbers for many
directions at once; only the contact that resists most in a direction has derivatives:

    h = a + mu |t|,   g = u_f + u_t x p / length,   a = -g . n,   t = g + a n,
    dh = w . dg + z . dn,   w = mu t/|t| - c n,   z = mu a t/|t| - c g,   c = 1 + mu t . n/|t|,
    dg = u_t x dp / length,   dn = N dp,

with outward normal n and its change N with the point. Off the surface, where least squares pass, n
need not be a unit vector; on it c is 1.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import casadi as ca
import numpy as np

from planner.numerics.kernels import loops_of_kernels
from planner.spatial import FloatArray, IntArray, cross
from planner.synthesis.mesh_surface import Field
from planner.synthesis.symbols import TINY, GraspSymbols
from planner.synthesis.terms.hand_points import Rows, end_row
from planner.synthesis.terms.term import ActiveRows, Role, Row, RowSource, Term

N_DIRECTIONS = 64
"""Most directions of wrench in one round: with few of them a round makes other directions weak."""

RESISTANCE_WEIGHT = 25.0
"""Weight of missing resistance: enough to move contacts by centimetres."""

RESISTANCE = Term(
    name="resistance",
    meaning="wrench resisted in each direction of a round, short of its target",
    role=Role.COST_BELOW_ZERO,
    unit="-",
    weight=RESISTANCE_WEIGHT,
    judged="epsilon of the plan",
)


class Resistance(RowSource):
    """Rows of resistance in given directions of wrench.

    Its outputs are normals at the contact points, and their Jacobians.
    """

    def __init__(self, symbols: GraspSymbols) -> None:
        """Write the expressions.

        Args:
            symbols: Unknowns and parameters.
        """
        pairs = zip(symbols.outward, symbols.points, strict=True)
        self.outputs = {
            "normals": ca.horzcat(*symbols.outward),
            # each transposed: columns are stored
            "normal_jacobians": ca.horzcat(*[ca.jacobian(n, p).T for n, p in pairs]),
        }
        self._unknowns = symbols.unknowns
        self._directions, self._target = _NONE, 0.0

    @property
    def rows(self) -> dict[Term, tuple[Row, ...]]:
        """See ``RowSource``."""
        return {RESISTANCE: tuple(RESISTANCE.row((), k) for k in range(len(self._directions)))}

    def receive(self, results: dict[str, FloatArray]) -> None:
        """See ``RowSource``."""
        self._outward = results["normals"]
        self._normal_jacobians = results["normal_jacobians"].reshape(-1, 3, 3)

    def set_parameters(self, values: dict[str, FloatArray], field: Field | None) -> None:
        """See ``RowSource``."""
        self._mu, self._length = float(values["mu"][0]), float(values["length"][0])
        self._directions, self._target = _NONE, 0.0

    def set_directions(self, directions: FloatArray, target: float = 0.0) -> None:
        """Directions (k, 6) of wrench from now on, and the resistance to reach in each (-).

        Raises:
            ValueError: More than ``N_DIRECTIONS``.
        """
        self._directions, self._target = checked_directions(directions), target

    def __call__(self, x: FloatArray) -> list[ActiveRows]:
        """See ``RowSource``."""
        if not len(self._directions):
            return []
        values, slopes, short = missing_resistance(
            self._directions,
            self._unknowns.points(x),
            self._outward,
            self._normal_jacobians,
            mu=self._mu,
            length=self._length,
            target=self._target,
        )
        rows = np.zeros((len(values), len(x)))
        rows[:, self._unknowns.point_columns] = slopes
        return [ActiveRows(RESISTANCE, values, rows, short)]


def checked_directions(directions: FloatArray) -> FloatArray:
    """Those of the directions (k, 6) that are not zero.

    Raises:
        ValueError: More than ``N_DIRECTIONS``.
    """
    if len(directions) > N_DIRECTIONS:
        raise ValueError(f"there are {len(directions)} directions; give up to {N_DIRECTIONS}")
    kept: FloatArray = directions[directions.any(axis=1)]
    return kept


_NONE = np.zeros((0, 6))


class ContactTables(NamedTuple):
    """The contacts for compiled loops.

    Attributes:
        normals_at: Where outward normals are in the work array (n, 3).
        slopes_at: Their Jacobians by the contacts, by rows (n, 9).
        first: First unknown of the contact points.
        taylor: Where the Taylor rows of a mesh begin in the work array; -1 without a mesh.
    """

    normals_at: IntArray
    slopes_at: IntArray
    first: int
    taylor: int


class ResistanceRun(NamedTuple):
    """What is to be resisted, for compiled loops.

    Attributes:
        directions: Directions of wrench (d, 6).
        target: Resistance to reach in each (-).
        mu: Friction (-).
        length: Characteristic length, m.
        resisted: Resistance of each contact (n,), overwritten.
        work: Force, and its part across the normal, (2, 3), overwritten.
    """

    directions: FloatArray
    target: float
    mu: float
    length: float
    resisted: FloatArray
    work: FloatArray


@loops_of_kernels
def resistance_rows(
    t: ContactTables, run: ResistanceRun, work: FloatArray, x: FloatArray, rows: Rows
) -> None:
    """Append the directions of wrench in which resistance falls short of its target."""
    u, f, mu, length = run.directions, run.work, run.mu, run.length
    for k in range(len(u)):
        highest = -math.inf
        for i in range(len(run.resisted)):
            pressed, across = _part(t, run, work, x, k, i)
            run.resisted[i] = pressed + mu * across
            highest = max(highest, run.resisted[i])
        best, size = 0, 0.0
        while run.resisted[best] < highest - TIE:
            best += 1
        for i in range(6):
            size += u[k, i] * u[k, i]
        value = run.resisted[best] - run.target * math.sqrt(size)
        if value >= 0.0:
            continue
        pressed, across = _part(t, run, work, x, k, best)
        n0, n1, n2 = (
            work[t.normals_at[best, 0]],
            work[t.normals_at[best, 1]],
            work[t.normals_at[best, 2]],
        )
        along = mu / across
        c = 1.0 + along * (f[1, 0] * n0 + f[1, 1] * n1 + f[1, 2] * n2)
        w0, w1, w2 = along * f[1, 0] - c * n0, along * f[1, 1] - c * n1, along * f[1, 2] - c * n2
        z0 = pressed * (along * f[1, 0]) - c * f[0, 0]
        z1 = pressed * (along * f[1, 1]) - c * f[0, 1]
        z2 = pressed * (along * f[1, 2]) - c * f[0, 2]
        at, first = rows.filled[1], t.first + 3 * best
        for j in range(3):
            a, b = (j + 1) % 3, (j + 2) % 3
            wa = w0 if a == 0 else (w1 if a == 1 else w2)
            wb = w0 if b == 0 else (w1 if b == 1 else w2)
            slope = (wa * u[k, 3 + b] - wb * u[k, 3 + a]) / length
            slope += z0 * work[t.slopes_at[best, j]]
            slope += z1 * work[t.slopes_at[best, 3 + j]]
            slope += z2 * work[t.slopes_at[best, 6 + j]]
            rows.columns[at + j], rows.entries[at + j] = first + j, RESISTANCE_WEIGHT * slope
        end_row(rows, RESISTANCE_WEIGHT * value, at + 3)


@loops_of_kernels
def _part(
    t: ContactTables, run: ResistanceRun, work: FloatArray, x: FloatArray, k: int, i: int
) -> tuple[float, float]:
    """The force of wrench k at contact i, and its part across the normal, into ``run.work``.

    Returns:
        Their sizes: along the normal, and across.
    """
    u, f, at = run.directions, run.work, t.first + 3 * i
    f[0, 0] = u[k, 0] + (u[k, 4] * x[at + 2] - u[k, 5] * x[at + 1]) / run.length
    f[0, 1] = u[k, 1] + (u[k, 5] * x[at] - u[k, 3] * x[at + 2]) / run.length
    f[0, 2] = u[k, 2] + (u[k, 3] * x[at + 1] - u[k, 4] * x[at]) / run.length
    n0, n1, n2 = work[t.normals_at[i, 0]], work[t.normals_at[i, 1]], work[t.normals_at[i, 2]]
    pressed = -(f[0, 0] * n0 + f[0, 1] * n1 + f[0, 2] * n2)
    f[1, 0], f[1, 1], f[1, 2] = (
        f[0, 0] + pressed * n0,
        f[0, 1] + pressed * n1,
        f[0, 2] + pressed * n2,
    )
    across = f[1, 0] * f[1, 0] + f[1, 1] * f[1, 1] + f[1, 2] * f[1, 2]
    return pressed, math.sqrt(across + TINY)


def missing_resistance(
    directions: FloatArray,
    points: FloatArray,
    outward: FloatArray,
    normal_jacobians: FloatArray,
    *,
    mu: float,
    length: float,
    target: float,
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Resistance less its target, (k,), where that is negative, derivatives (k, 3 n), directions.

    The last are the numbers (k,) of the directions that fall short.

    Args:
        directions: Directions of wrench u (m, 6), torques over ``length``; targets scale with them.
        points: Contact points (n, 3), m.
        outward: Normals (n, 3).
        normal_jacobians: Derivative of each normal by its point (n, 3, 3), 1/m.
        mu: Friction (-).
        length: Characteristic length, m.
        target: Resistance (normal forces sum to 1) to reach per unit of ``directions``.
    """
    # contacts come first, so that every product below is a product of matrices
    g = directions[:, :3] + directions[:, 3:] @ _turning(points / length)  # (n, m, 3)
    pressed = -(g @ outward[:, :, None])[:, :, 0]  # (n, m)
    t = g + pressed[:, :, None] * outward[:, None, :]
    across = np.sqrt(np.einsum("nmi,nmi->nm", t, t) + TINY)
    resisted = pressed + mu * across
    best = (resisted >= resisted.max(axis=0) - TIE).argmax(axis=0)
    every = np.arange(len(directions))
    values = resisted[best, every] - target * np.sqrt(np.einsum("mi,mi->m", directions, directions))
    short = np.flatnonzero(values < 0.0)
    i = best[short]
    n, g, pressed = outward[i], g[i, short], pressed[i, short][:, None]
    along = (mu / across[i, short])[:, None] * t[i, short]
    c = 1.0 + np.einsum("ki,ki->k", along, n)[:, None]
    u, w, z = directions[short, 3:], along - c * n, pressed * along - c * g
    slope = cross(w, u) / length
    slope += (z[:, None, :] @ normal_jacobians[i])[:, 0]
    rows = np.zeros((len(short), *points.shape))
    rows[np.arange(len(short)), i] = slope
    return values[short], rows.reshape(len(short), points.size), short


def least_resisted(
    points: FloatArray, outward: FloatArray, *, mu: float, length: float
) -> FloatArray:
    """Least resistance of sets of contacts over a sample of directions, (k,): epsilon or more.

    Args:
        points: (k, n, 3), m.
        outward: Unit normals (k, n, 3).
        mu: Friction (-).
        length: Characteristic length, m.
    """
    flat, n = points.reshape(-1, 3), outward.reshape(-1, 3)
    g = SAMPLE[:, :3] + SAMPLE[:, 3:] @ _turning(flat / length)  # (k n, m, 3)
    pressed = -(g @ n[:, :, None])[:, :, 0]
    across = np.einsum("nmi,nmi->nm", g, g) - pressed * pressed
    resisted = pressed + mu * np.sqrt(np.maximum(across, 0.0))
    least: FloatArray = resisted.reshape(*points.shape[:2], -1).max(axis=1).min(axis=1)
    return least


def _sample(count: int) -> FloatArray:
    """Directions of wrench (count, 6), spread at random, always the same."""
    found = np.random.default_rng(0).normal(size=(count, 6))
    found /= np.linalg.norm(found, axis=1, keepdims=True)
    return found


SAMPLE = _sample(128)
"""Directions in which starts are compared: enough for a ranking, too few for epsilon."""


def _turning(p: FloatArray) -> FloatArray:
    """Matrices (n, 3, 3) from which u @ matrix is u x p."""
    out = np.zeros((len(p), 3, 3))
    out[:, NEXT, AFTER] = -p[:, AXIS]
    out[:, AFTER, NEXT] = p[:, AXIS]
    return out


TIE = 1e-9
"""Contacts whose resistance differs by less than this (-) resist alike, and the first counts: faces
of a box give exact ties, which rounding must not decide."""

AXIS, NEXT, AFTER = np.arange(3), np.array([1, 2, 0]), np.array([2, 0, 1])
