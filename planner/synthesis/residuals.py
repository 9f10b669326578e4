"""The terms and the cost of grasp synthesis as weighted residuals with their Jacobian.

The same expressions as the NLP's. CasADi differentiates them once; each call writes into arrays
that are kept, with no conversion of matrices in between.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from planner.spatial import FloatArray
from planner.stages import stage
from planner.synthesis.compiled import compiled
from planner.synthesis.nlp import SECOND, THIRD, Field, FieldPoints
from planner.synthesis.terms import N_DIRECTIONS, Formulation

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
QUALITY_SHARE = 15.0
"""Residual of one unit of missing resistance: enough to move contacts by centimetres. What it costs
the terms is mended by a last descent without it."""


class Residuals:
    """Weighted residuals r(x) (m,) and their Jacobian (m, n): terms first, then costs.

    Attributes:
        values: (m,), overwritten by every call.
        jacobian: (m, n), likewise.
        equality: Whether a residual counts on both sides of zero; the others where negative.
        n_terms: How many belong to terms.
    """

    def __init__(self, formulation: Formulation, points: FieldPoints | None) -> None:
        """Differentiate.

        Args:
            formulation: Terms and cost.
            points: Where they need a distance field.
        """
        terms, x, p = formulation.terms, formulation.x, formulation.p
        self._points = points if points is not None and len(points) else None
        tau = ca.SX(0, 1) if self._points is None else self._points.symbols
        rows = [WEIGHTS[t.name] * (t.expression - SPARE.get(t.name, 0.0)) for t in terms]
        rows += [COST_SHARE * formulation.cost_rows, QUALITY_SHARE * formulation.quality_rows]
        residual = ca.densify(ca.vertcat(*rows))
        jacobian = ca.jacobian(residual, x)
        sizes = [t.expression.numel() for t in terms]
        self._names = [t.name for t, m in zip(terms, sizes, strict=True) for _ in range(m)]
        self.n_terms = sum(sizes)
        both = [t.equality for t, m in zip(terms, sizes, strict=True) for _ in range(m)]
        self.equality: NDArray[np.bool_] = np.array(
            both
            + [True] * formulation.cost_rows.numel()
            + [False] * formulation.quality_rows.numel()
        )
        self._x, self._p, self._tau = (np.zeros(v.numel()) for v in (x, p, tau))
        self.values: FloatArray = np.zeros(residual.numel())
        self.jacobian: FloatArray = np.zeros((residual.numel(), x.numel()))
        row, column = (np.array(v) for v in jacobian.sparsity().get_triplet())
        self._entries, self._at = np.zeros(len(row)), row * x.numel() + column
        self._call = _into_buffers(
            compiled(ca.Function("residuals", [x, p, tau], [residual, jacobian])),
            [self._x, self._p, self._tau],
            [self.values, self._entries],
        )
        if self._points is not None:
            n2, n3 = self._points.counts
            self._places = np.zeros((n2 + n3, 3))
            self._call_places = _into_buffers(
                ca.Function("places", [x, p], [ca.densify(self._points.points)]),
                [self._x, self._p],
                [self._places],
            )
            split = n2 * (3 + SECOND)
            self._second = self._tau[:split].reshape(n2, 3 + SECOND)
            self._third = self._tau[split:].reshape(n3, 3 + THIRD)

    def set_parameters(self, p: FloatArray) -> None:
        """Parameters for the calls that follow."""
        self._p[:] = p

    def set_directions(self, directions: FloatArray) -> None:
        """Directions (k, 6) of wrench to work on from now on."""
        free = self._p[-6 * N_DIRECTIONS :]
        free[:] = 0.0
        free[: directions.size] = directions.ravel()

    def __call__(self, x: FloatArray, field: Field | None) -> tuple[FloatArray, FloatArray]:
        """``values`` and ``jacobian`` at x, overwritten by the next call."""
        with stage("residuals"):
            return self._evaluate(x, field)

    def _evaluate(self, x: FloatArray, field: Field | None) -> tuple[FloatArray, FloatArray]:
        self._x[:] = x
        if self._points is not None:
            if field is None:
                raise TypeError("these residuals need a distance field")
            self._call_places()
            n2 = len(self._second)
            # first derivatives of the residuals need one order less than the NLP's second ones
            self._second[:, :3], self._third[:, :3] = self._places[:n2], self._places[n2:]
            self._second[:, 3:7] = field.taylor(self._places[:n2], 1)
            self._third[:, 3:13] = field.taylor(self._places[n2:], 2)
        self._call()
        self.jacobian.ravel()[self._at] = self._entries
        return self.values, self.jacobian

    def violations(self) -> dict[str, float]:
        """Largest violation of each term at the last x, in its unit."""
        out = dict.fromkeys(self._names, 0.0)
        for i, name in enumerate(self._names):
            value = float(self.values[i]) / WEIGHTS[name] + SPARE.get(name, 0.0)
            out[name] = max(out[name], abs(value) if self.equality[i] else -value)
        return out


def _into_buffers(
    function: Any, arguments: list[FloatArray], results: list[FloatArray]
) -> Callable[[], None]:
    """A call that reads and writes these arrays."""
    buffer, trigger = function.buffer()
    for i, array in enumerate(arguments):
        buffer.set_arg(i, array.data)
    for i, array in enumerate(results):
        buffer.set_res(i, array.data)

    def call(_kept: Any = (function, buffer)) -> None:
        trigger()

    return call
