"""The terms and the cost of grasp synthesis as weighted residuals with their Jacobian.

The same expressions as the NLP's. CasADi differentiates them once; each call writes into arrays
that are kept, with no conversion of matrices in between. Clearances, which are many and seldom
violated, come from ``planner.synthesis.avoid``.
"""

from __future__ import annotations

from copy import copy
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from planner.numerics.casadi_buffers import into_buffers
from planner.numerics.casadi_compiled import compiled
from planner.spatial import FloatArray, IntArray
from planner.synthesis.avoid import TERMS, Avoidance, Violated
from planner.synthesis.gaps import Gaps
from planner.synthesis.nlp import THIRD, Field, FieldPoints
from planner.synthesis.resistance import missing_resistance
from planner.synthesis.terms import Formulation
from planner.system.stage_times import stage

__all__ = ["COST_SHARE", "WEIGHTS", "Residuals"]

PER_METRE = 1e3
"""A millimetre is one unit of residual."""

WEIGHTS = {
    "touch": PER_METRE,
    "surface": PER_METRE,
    "object": PER_METRE,
    "table": PER_METRE,
    "obstacle": PER_METRE,
    "fingers": PER_METRE / 0.03,  # squared distances: two links are some 15 mm apart
    "links": PER_METRE,
    "arm": PER_METRE,
    "coupling": 50.0,
    "balance": 20.0,
    "level": 20.0,
    "facing": 20.0,
    "cone": 20.0,
    "press": 20.0,
    "stop": 10.0,
}
"""Residual of one unit of a term's violation. Where no length is involved, about a twentieth of a
normal force, of a cosine or of a radian counts like a millimetre."""

SPARE = {"facing": 0.02}
"""By how much (in the term's unit) residuals ask for more than the term does, where the verdict
leaves no room: least squares end on the wrong side of an inequality by a little."""

COST_SHARE = 0.2
"""Residual of one unit of the square root of the cost, which ranks grasps but must not outweigh
contact. With half of it forces are infeasible more often, with twice of it descents are slower."""
EDGE_SHARE = 20.0
"""Residual of one unit of slope that the smooth distance lacks at a contact: an edge lacks 0.2."""

QUALITY_SHARE = 25.0
"""Residual of one unit of missing resistance: enough to move contacts by centimetres."""


class Residuals:
    """Weighted residuals r(x) that count, (m,), and their Jacobian (m, n): terms, then costs.

    One descent at a time works with them; another takes a ``twin``.

    Attributes:
        formulation: Terms without clearances, and cost.
        n_terms: After a call: how many of the first ones belong to terms.
    """

    def __init__(
        self, formulation: Formulation, points: FieldPoints | None, avoidance: Avoidance
    ) -> None:
        """Differentiate.

        Args:
            formulation: Terms and cost, without clearances.
            points: Where they need a distance field: at contact points.
            avoidance: The clearances.
        """
        terms, x, p = formulation.terms, formulation.x, formulation.p
        self.formulation, self._avoidance = formulation, avoidance
        self._points = points if points is not None and len(points) else None
        tau = ca.SX(0, 1) if self._points is None else self._points.symbols
        rows = [WEIGHTS[t.name] * (t.expression - SPARE.get(t.name, 0.0)) for t in terms]
        sided = ca.vertcat(
            EDGE_SHARE * formulation.edge_rows, QUALITY_SHARE * formulation.objective_rows
        )
        rows += [COST_SHARE * formulation.cost_rows, sided]
        residual = ca.densify(ca.vertcat(*rows))
        jacobian = ca.jacobian(residual, x)
        sizes = [t.expression.numel() for t in terms]
        self._names = [t.name for t, m in zip(terms, sizes, strict=True) for _ in range(m)]
        self._n_terms = self.n_terms = sum(sizes)
        both = [t.equality for t, m in zip(terms, sizes, strict=True) for _ in range(m)]
        self._both: NDArray[np.bool_] = np.array(
            both + [True] * formulation.cost_rows.numel() + [False] * sided.numel()
        )
        row, column = (np.array(v) for v in jacobian.sparsity().get_triplet())
        self._at, self._width = row * x.numel() + column, x.numel()
        outputs = {name: ca.densify(v) for name, v in avoidance.outputs.items()}
        normals, bending = ca.densify(formulation.normals), ca.densify(_bending(formulation))
        results = [residual, jacobian, normals, bending, *outputs.values()]
        self._links = tuple(outputs)
        self._function = compiled(ca.Function("residuals", [x, p, tau], results))
        self._make_room()
        self._weights = np.array([WEIGHTS[name] for name in TERMS])
        self._field: Field | None = None
        self._violated: Violated

    def _make_room(self) -> None:
        """Arrays for arguments and results."""
        f = self._function
        self._x, self._p, self._tau = (np.zeros(f.numel_in(i)) for i in range(3))
        self._values, self._entries = np.zeros(f.numel_out(0)), np.zeros(f.nnz_out(1))
        self._jacobian = np.zeros((len(self._values), self._width))
        # matrices are transposed: CasADi stores columns
        rest = [np.zeros(f.size_out(i)[::-1]) for i in range(2, f.n_out())]
        self._outward, self._bending, *links = rest
        self._avoidance.receive(dict(zip(self._links, links, strict=True)))
        arguments = [self._x, self._p, self._tau]
        self._call = into_buffers(f, arguments, [self._values, self._entries, *rest])

    def twin(self) -> Residuals:
        """The same expressions with parameters and results of their own, in 0.06 ms."""
        other = copy(self)
        other._avoidance = copy(self._avoidance)
        other._make_room()
        return other

    def bind(self, p: FloatArray, field: Field | None) -> None:
        """Parameters, and the distance field of a mesh, for the calls that follow."""
        if self._points is not None and field is None:
            raise TypeError("these residuals need a distance field")
        self._p[:] = p
        self._field = field
        self._avoidance.bind(self.formulation.unpack(self._p), field)

    def set_directions(self, directions: FloatArray, aim: float = 0.0) -> None:
        """Directions (k, 6) of wrench to work on from now on; resistance to aim at in each (-)."""
        self._p[self.formulation.places["aim"]] = aim
        free = self._p[self.formulation.places["directions"]]
        free[:] = 0.0
        free[: directions.size] = directions.ravel()

    def set_objectives(self, values: FloatArray) -> None:
        """Parameters of the objectives' rows from now on; none switches them off."""
        self._p[self.formulation.places["objectives"]] = values if values.size else 0.0

    def keep_apart(self, gaps: Gaps | None) -> None:
        """Clearances of the true links that count from now on; None for none."""
        self._avoidance.keep(gaps)

    def __call__(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Those that count at x: overwritten by the next call."""
        with stage("residuals"):
            return self._evaluate(x)

    def _evaluate(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        self._x[:] = x
        if self._field is not None:
            points = self.formulation.unknowns.points(x)
            taylor = self._tau.reshape(len(points), 3 + THIRD)
            taylor[:, :3] = points
            # first derivatives of the residuals need one order less than the NLP's second ones
            taylor[:, 3:13] = self._field.taylor(points, 2)
        self._call()
        self._jacobian.ravel()[self._at] = self._entries
        counts = self._both | (self._values < 0.0)
        self._violated = self._avoidance(x)
        weights = self._weights[self._violated.terms]
        self.n_terms = len(weights) + int(np.count_nonzero(counts[: self._n_terms]))
        missing, slopes = self._missing(x)
        return (
            np.concatenate([weights * self._violated.values, self._values[counts], missing]),
            np.vstack([weights[:, None] * self._violated.rows, self._jacobian[counts], slopes]),
        )

    def _missing(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Rows of the resistance that is missing, and their derivatives."""
        places, unknowns = self.formulation.places, self.formulation.unknowns
        directions = self._p[places["directions"]].reshape(-1, 6)
        directions = directions[directions.any(axis=1)]
        if not len(directions):
            return np.zeros(0), np.zeros((0, len(x)))
        values, slopes = missing_resistance(
            directions,
            unknowns.points(x),
            self._outward,
            self._bending.reshape(-1, 3, 3),
            mu=float(self._p[places["mu"]][0]),
            length=float(self._p[places["length"]][0]),
            aim=float(self._p[places["aim"]][0]),
        )
        rows = np.zeros((len(values), len(x)))
        rows[:, unknowns.point_columns] = QUALITY_SHARE * slopes
        return QUALITY_SHARE * values, rows

    @property
    def avoided(self) -> IntArray:
        """Which clearances were violated at the last x: numbers of their terms (k,)."""
        return self._violated.terms

    def violations(self) -> dict[str, float]:
        """Largest violation of each term at the last x, in its unit."""
        out = dict.fromkeys([*self._names, *TERMS], 0.0)
        for i, name in enumerate(self._names):
            value = float(self._values[i]) / WEIGHTS[name] + SPARE.get(name, 0.0)
            out[name] = max(out[name], abs(value) if self._both[i] else -value)
        for k, value in zip(self._violated.terms, self._violated.values, strict=True):
            out[TERMS[k]] = max(out[TERMS[k]], -float(value))
        return out


def _bending(formulation: Formulation) -> Any:
    """Derivatives of the normals by their points (3, 3 n), each transposed: columns are stored."""
    normals, x = formulation.normals, formulation.x
    columns = formulation.unknowns.point_columns
    return ca.horzcat(
        *[
            ca.jacobian(normals[:, i], x[columns][3 * i : 3 * i + 3]).T
            for i in range(normals.shape[1])
        ]
    )
