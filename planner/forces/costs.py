"""``QuadraticCost``: what forces cost beside their squares, one object for each reason.

    1/2 f'P f + q'f

f are the contact force components of all contacts one after the other: f_n, f_t1, f_t2 (N) and
tau_n (N m), as far as each contact's model has them (``ContactSet.dims``), in the contact frames.
``distribute_forces`` and ``ForceLoop`` take a list of such costs. A new one is a new object::

    spread = QuadraticCost.of_residual(matrix, target, weight=2.0, name="equal normal forces")
    distribute_forces(contacts, wrench=weight, costs=[spread])
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from planner.arrays import checked_number, float_array
from planner.errors import ContactError
from planner.spatial import FloatArray

CONVEX_TOL = 1e-9
"""Least eigenvalue of P, as a share of the largest (-), below which a cost is not convex."""


@dataclass(frozen=True, kw_only=True, eq=False)
class QuadraticCost:
    """A convex quadratic cost of contact forces; a squared normal force of 1 N costs 1/2 already.

    Attributes:
        p: P (n, n), symmetric, positive semidefinite, per N^2.
        q: (n,), per N.
        name: What it is for; printed with the problem.
    """

    p: FloatArray
    q: FloatArray
    name: str

    def __post_init__(self) -> None:
        """Check shapes and convexity; freeze the arrays.

        Raises:
            ContactError: Shapes do not fit, a number is not finite, or P is not symmetric and
                positive semidefinite.
        """
        for name in ("p", "q"):
            value = float_array(f"{name} of cost {self.name!r}", getattr(self, name), copy=True)
            value.flags.writeable = False
            object.__setattr__(self, name, value)
        n = len(self.q) if self.q.ndim == 1 else -1
        if self.p.shape != (n, n) or not (np.isfinite(self.p).all() and np.isfinite(self.q).all()):
            raise ContactError(
                f"cost {self.name!r} has p of shape {self.p.shape} and q of shape {self.q.shape}; "
                "give finite (n, n) and (n,), one entry per force component"
            )
        size = float(np.abs(self.p).max(initial=0.0))
        if np.abs(self.p - self.p.T).max(initial=0.0) > CONVEX_TOL * size or (
            n and np.linalg.eigvalsh(self.p)[0] < -CONVEX_TOL * size
        ):
            raise ContactError(
                f"cost {self.name!r} is not convex: p must be symmetric with no negative "
                "eigenvalue; a matrix M'M always is"
            )

    @classmethod
    def of_residual(
        cls, matrix: ArrayLike, target: ArrayLike, *, weight: float, name: str
    ) -> QuadraticCost:
        """The cost weight/2 |matrix @ f - target|^2.

        Args:
            matrix: (k, n).
            target: (k,).
            weight: >= 0, beside a squared normal force in N.
            name: What it is for.

        Raises:
            ContactError: The weight is negative or not finite, or shapes do not fit.
        """
        checked_number(f"the weight of cost {name!r}", weight, least=0.0)
        m, t = float_array(f"the matrix of {name!r}", matrix), float_array("target", target)
        if m.ndim != 2 or t.shape != m.shape[:1]:
            raise ContactError(
                f"cost {name!r} has a matrix of shape {m.shape} and a target of shape {t.shape}; "
                "give (k, n) and (k,)"
            )
        return cls(p=weight * m.T @ m, q=-weight * m.T @ t, name=name)

    def check_size(self, n: int) -> None:
        """Refuse a cost of another number of force components.

        Raises:
            ContactError: It is.
        """
        if len(self.q) != n:
            raise ContactError(
                f"cost {self.name!r} is of {len(self.q)} force components, but the contacts have "
                f"{n}: three per point contact, four per soft one, one without friction"
            )
