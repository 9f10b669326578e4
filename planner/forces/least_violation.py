"""Lexicographic answer to an infeasible wrench: least unbalanced wrench first, then least cost.

    r* = the least |G f + wrench| within friction, normal and torque limits
    f* = the least cost of forces with G f + wrench = r*

The norm counts torque divided by the problem's length. r* is unique, since the norm is strictly
convex and the wrenches that contacts can make are a convex set.

``Relaxation`` gives the balance a cost of its own instead, and follows the method of multipliers:
each round adds the multiplier of the unbalanced wrench. Where forces exist the rounds converge to
balance, and where none do, to r* and f* (Chiche, Gilbert, "How the augmented Lagrangian algorithm
can deal with an infeasible convex quadratic optimization problem", 2016). The first round leaves a
millionth of the forces more than r*, which is enough for a controller.
"""

from __future__ import annotations

import numpy as np

from planner.numerics.qp_workspace import DenseQp, qp_workspace
from planner.spatial import FloatArray

VIOLATION_WEIGHT = 1e6
"""Cost of a squared newton of unbalanced wrench over that of a squared newton of contact force (-):
an infeasible wrench stays unbalanced by the least and a millionth of the forces."""

LARGEST_DUAL = 100.0
"""Largest plausible multiplier of the balance (N per N), beside the wrench's size: two contacts
that bear it by a friction of 0.1 have 50. Of a wrench that can be met, the first round leaves at
most this over ``VIOLATION_WEIGHT``."""

ROUNDS = 20
"""Most rounds (-)."""

AGREED = 1e-10
"""Change of the unbalanced wrench between rounds, over the wrench's size, that ends them (-)."""


class Relaxation:
    """A force programme whose first rows, the balance, are a cost; kept between wrenches.

    Attributes:
        qp: The programme with the balance.
        loose: The same without it.
        solver: The solver of ``loose``; ``solver.x`` is the last answer.
    """

    def __init__(self, qp: DenseQp, solver: str) -> None:
        """For a programme, which is kept, not copied, and a solver's name."""
        self.qp, self.loose = qp, qp.without_equalities()
        self.solver = qp_workspace(solver, self.loose)

    def solve(self, tolerance: float, *, exact: bool = False) -> FloatArray:
        """Forces (nx,) that leave the least over, NaN where the limits contradict each other.

        Args:
            tolerance: Largest unbalanced wrench that counts as balanced.
            exact: Whether to go on until rounds agree; else a second round follows only where the
                first may have left over no more than the cost lets through.
        """
        qp, loose, k = self.qp, self.loose, self.qp.equalities
        table, wanted = qp.a[:k], qp.low[:k]
        loose.p[:] = qp.p + VIOLATION_WEIGHT * (table.T @ table)
        loose.q[:] = qp.q - VIOLATION_WEIGHT * (table.T @ wanted)
        loose.a[:], loose.low[:], loose.high[:] = qp.a[k:], qp.low[k:], qp.high[k:]
        loose.lower[:], loose.upper[:] = qp.lower, qp.upper
        loose.new_p = loose.new_q = loose.new_a = True
        self.solver.solve()
        size = float(np.linalg.norm(wanted))
        last = np.full(k, np.inf)
        for _ in range(ROUNDS if exact else 1):
            missed = wanted - table @ self.solver.x
            off = float(np.abs(missed).max())
            through = exact or tolerance < off <= LARGEST_DUAL * size / VIOLATION_WEIGHT
            if not through or np.abs(missed - last).max() <= AGREED * size:
                break
            last = missed
            loose.q -= VIOLATION_WEIGHT * (table.T @ missed)
            loose.new_q = True
            self.solver.solve()
        return self.solver.x
