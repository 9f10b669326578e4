"""Small dense linear and quadratic programmes, by the hundred: solvers that CasADi brings.

    min  x'H x / 2 + g'x    s.t.  low <= A x <= high,  lower <= x <= upper

DAQP (Arnström, Bemporad, Axehill, "A dual active-set solver for embedded quadratic programming
using recursive LDL' updates", 2022) solves the quadratic ones of this project to rounding in 20 to
300 us, HiGHS the linear ones in 0.2 to 1 ms. CasADi's call by arguments would add 0.25 ms of
converting; through its buffers it adds 10 us. What is said to be solved is checked to be allowed.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any, Literal

import casadi as ca
import numpy as np

from planner.spatial import FloatArray

__all__ = ["Programme", "programme"]

_OPTIONS: dict[str, dict[str, Any]] = {
    "daqp": {"daqp": {"primal_tol": 1e-10}},
    "highs": {
        "highs": {
            "output_flag": False,
            "presolve": "off",
            "primal_feasibility_tolerance": 1e-10,
            "dual_feasibility_tolerance": 1e-10,
        }
    },
}
"""HiGHS at its tightest; presolve costs more time than it saves at these sizes."""

KEPT = 64
"""Solvers that are kept, one for every size."""

FEASIBLE_TOL = 1e-8
"""Largest violation of a row or a bound, by the larger of the largest unknown and 1, of what counts
as a solution. DAQP is a dual method: what it gives is the minimum if it is allowed."""


class Programme:
    """A solver for programmes of one size."""

    def __init__(self, solver: Literal["daqp", "highs"], n: int, m: int) -> None:
        """Make it for n unknowns and m rows; HiGHS for H = 0."""
        quadratic = solver == "daqp"
        shapes = {"a": ca.Sparsity.dense(m, n)}
        if quadratic:
            shapes["h"] = ca.Sparsity.dense(n, n)
        self._solve = ca.conic(
            "programme", solver, shapes, {"error_on_fail": False, **_OPTIONS[solver]}
        )
        made: Any = self._solve.buffer()  # kept: the solver works in it
        self._buffer, self._run = made
        self._in = {
            name: np.zeros(self._solve.sparsity_in(name).nnz()) for name in self._solve.name_in()
        }
        for name, values in self._in.items():
            self._buffer.set_arg(self._solve.index_in(name), values.data)
        self._x, self._rows, self._bounds = np.zeros(n), np.zeros(m), np.zeros(n)
        outputs = {"x": self._x, "lam_a": self._rows, "lam_x": self._bounds}
        for name, values in outputs.items():
            self._buffer.set_res(self._solve.index_out(name), values.data)

    @property
    def row_prices(self) -> FloatArray:
        """After a solution: change of the least cost per unit of each row's limit, (m,)."""
        return -self._rows

    @property
    def bound_prices(self) -> FloatArray:
        """The same of the bounds, (n,): >= 0 at a lower, <= 0 at an upper bound."""
        return -self._bounds

    def solve(self, **values: FloatArray) -> FloatArray | None:
        """The minimiser (n,), None where there is none.

        Args:
            **values: h (n, n), symmetric; g (n,); a (m, n); lba, uba (m,); lbx, ubx (n,).
        """
        # DAQP does not end where it is given NaN
        if not math.isfinite(sum(float(values[k].sum()) for k in ("h", "g", "a") if k in values)):
            return None
        for name, value in values.items():
            self._in[name][:] = value.ravel(order="F")
        self._x.fill(np.nan)
        self._run()
        x = self._x.copy()
        rows, size = values["a"] @ x, max(1.0, float(np.abs(x).max()))
        for part, low, high in ((rows, "lba", "uba"), (x, "lbx", "ubx")):
            # where there is no solution, what is left in the buffer is none either; NaN too
            outside = np.maximum(values[low] - part, part - values[high])
            if not outside.max(initial=0.0) <= FEASIBLE_TOL * size:
                return None
        return x


@lru_cache(maxsize=KEPT)
def programme(solver: Literal["daqp", "highs"], n: int, m: int) -> Programme:
    """The solver for a size; the last few are kept."""
    return Programme(solver, n, m)
