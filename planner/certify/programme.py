"""Small linear programmes, by the hundred: HiGHS through CasADi.

The programmes of this room take HiGHS half a millisecond. SciPy's way to the same solver adds five
more of checking options, CasADi's less than one.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from planner.errors import PlannerError
from planner.spatial import FloatArray

__all__ = ["SOLVER_TOL", "Minimum", "minimise"]

SOLVER_TOL = 1e-9
"""Primal and dual feasibility tolerance of HiGHS."""

KEPT = 64
"""Solvers that are kept, one for every size of programme."""

_OPTIONS: dict[str, Any] = {
    "output_flag": False,
    "primal_feasibility_tolerance": SOLVER_TOL,
    "dual_feasibility_tolerance": SOLVER_TOL,
}


@dataclass(frozen=True, kw_only=True, eq=False)
class Minimum:
    """A solved programme.

    Attributes:
        value: Least cost.
        x: (n,), where it is reached.
        prices: (m,), change of the least cost per unit of each row's limit.
    """

    value: float
    x: FloatArray
    prices: FloatArray


def minimise(
    cost: FloatArray,
    rows: FloatArray,
    row_limits: FloatArray,
    bounds: FloatArray,
) -> Minimum | None:
    """Least cost . x with row limits on rows @ x and bounds on x.

    Args:
        cost: (n,).
        rows: (m, n).
        row_limits: (m, 2), least and greatest; may be infinite, or equal.
        bounds: (n, 2), the same of x.

    Returns:
        The minimum, or None where no x is allowed, or where there is none (n = 0).

    Raises:
        PlannerError: There is no least cost, or HiGHS met numerical trouble.
    """
    if not len(cost):
        return None
    for presolve in ("off", "on"):
        solver = _solver(*rows.shape, presolve)
        out = solver(
            g=cost,
            a=rows,
            lba=row_limits[:, 0],
            uba=row_limits[:, 1],
            lbx=bounds[:, 0],
            ubx=bounds[:, 1],
        )
        status = solver.stats()["return_status"]
        if status in ("Optimal", "Infeasible"):
            break
    if status == "Infeasible":
        return None
    if status != "Optimal":
        raise PlannerError(
            f"HiGHS gave up on a linear programme of a certificate ({status}); report this grasp, "
            "and meanwhile certify it at another width"
        )
    return Minimum(
        value=float(out["cost"]),
        x=np.array(out["x"]).ravel(),
        prices=-np.array(out["lam_a"]).ravel(),
    )


@lru_cache(maxsize=KEPT)
def _solver(m: int, n: int, presolve: str) -> Any:
    """HiGHS for programmes of m rows and n columns. Presolve takes time and is seldom needed."""
    options: Any = {"error_on_fail": False, "highs": {**_OPTIONS, "presolve": presolve}}
    return ca.conic("certify", "highs", {"a": ca.Sparsity.dense(m, n)}, options)
