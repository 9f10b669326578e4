"""Small linear programmes of certificates: a least cost, or the certainty that there is none."""

from __future__ import annotations

from dataclasses import dataclass

from planner.errors import PlannerError
from planner.numerics.programme import ScipyProgramme
from planner.spatial import FloatArray

__all__ = ["Minimum", "minimise"]


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
    values = {
        "g": cost,
        "a": rows,
        "lba": row_limits[:, 0],
        "uba": row_limits[:, 1],
        "lbx": bounds[:, 0],
        "ubx": bounds[:, 1],
    }
    solver = ScipyProgramme()
    x = solver.solve(**values)
    if solver.infeasible:
        return None
    if x is None:
        raise PlannerError(
            "HiGHS gave up on a linear programme of a certificate; report this grasp, and "
            "meanwhile certify it at another width"
        )
    return Minimum(value=float(cost @ x), x=x, prices=solver.row_prices)
