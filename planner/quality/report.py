"""Everything that this package says about a set of contacts, in one report.

The same report judges a plan and what MuJoCo made of it::

    report = analyse(contacts, length=0.04)
    print(report)
    report.closure.closed, report.epsilon_round.lower

How evenly the grasp map turns contact forces into wrenches: its singular values.

The grasp map G of ``planner.contacts`` is taken with every row and every column in newtons: torque
on the object and torsional moments at the contacts are both divided by the characteristic length.
Friction and the sign of forces do not enter, so these say how well placed the contacts are, not
whether they close the grasp. (Roa and Suarez 2015, "Grasp quality measures: review", section 2.1.)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from planner.arrays import short_repr
from planner.contacts import ContactSet, check_contacts
from planner.errors import ContactError
from planner.quality.ball import Interval, check_hull, epsilon_linf, epsilon_round, measure_hull
from planner.quality.closure import ClosureResult, RoundCones, force_closure, primitive_wrenches
from planner.spatial import FloatArray
from planner.tolerances import CLOSURE_EDGES


def singular_values(contacts: ContactSet, *, length: float) -> FloatArray:
    """Six singular values (-) of the scaled grasp map, descending, zeros where the rank is less.

    Args:
        contacts: n contacts.
        length: Torque is divided by it, m.

    Raises:
        ContactError: ``length`` is not positive.
    """
    maps = RoundCones.of(contacts, length).maps * np.array([1.0, 1.0, 1.0, length])
    g = np.hstack([np.zeros((6, 6)), *maps])
    values: FloatArray = np.linalg.svd(g, compute_uv=False)
    return values


def smallest_singular_value(contacts: ContactSet, *, length: float) -> float:
    """Least wrench per unit of contact force (-): 0 where a wrench cannot be applied at all.

    Raises:
        ContactError: ``length`` is not positive.
    """
    return float(singular_values(contacts, length=length)[-1])


def isotropy(contacts: ContactSet, *, length: float) -> float:
    """Smallest over largest singular value of the scaled grasp map (-), in [0, 1].

    Raises:
        ContactError: ``length`` is not positive.
    """
    values = singular_values(contacts, length=length)
    return float(values[-1] / values[0]) if values[0] > 0 else 0.0


ROUND_REL_TOL = 0.05
"""Width of a report's interval for true cones, as a share of its upper end (-)."""

ROUND_POINTS = 60
"""Points that a report may spend on it (-)."""

LINF_REL_TOL = 0.1
"""The same for bounded single forces (-); soft contacts often leave more, and it still holds."""

LINF_POINTS = 40
"""Points that a report may spend on it (-). Call ``epsilon_linf`` for a narrower interval."""

QUICK_EDGES = 4
"""Edges per cone where time matters more than the last tenth of epsilon (-)."""

CLEARLY_CLOSED = 1e-4
"""Epsilon above this share of the longest primitive wrench leaves no doubt about closure (-): the
normalised min-weight is then nearly as large, far above what counts as positive."""


@dataclass(frozen=True, kw_only=True, eq=False)
class QualityReport:
    """Quality of a grasp, from its contacts alone.

    Attributes:
        n_contacts: Number of contacts.
        edges: Edges per inscribed cone in ``closure``, ``epsilon`` and ``volume``.
        length: Characteristic length that torque is divided by, m.
        closure: Force closure with its certificate and min-weight.
        epsilon: L1 epsilon of the discretised cones (-), exact.
        epsilon_round: L1 epsilon of the true cones (-).
        epsilon_linf: Epsilon of the true cones with each normal force in [0, 1] (-).
        weakest_wrench: (6,), [N; N m], the wrench on the object of unit size (torque divided by
            ``length``) that takes most normal force to balance.
        volume: Volume (-) of the hull of primitive wrenches.
        smallest_singular_value: Of the scaled grasp map (-).
        isotropy: Smallest over largest singular value (-).
    """

    n_contacts: int
    edges: int
    length: float
    closure: ClosureResult
    epsilon: float
    epsilon_round: Interval
    epsilon_linf: Interval
    weakest_wrench: FloatArray
    volume: float
    smallest_singular_value: float
    isotropy: float

    def to_dict(self) -> dict[str, Any]:
        """Plain data for JSON; units in the names where there are any, intervals as pairs."""
        return {
            "n_contacts": self.n_contacts,
            "edges": self.edges,
            "length_m": self.length,
            "closure": self.closure.to_dict(),
            "epsilon": self.epsilon,
            "epsilon_round": [self.epsilon_round.lower, self.epsilon_round.upper],
            "epsilon_linf": [self.epsilon_linf.lower, self.epsilon_linf.upper],
            "weakest_wrench_n_nm": [float(x) for x in self.weakest_wrench],
            "volume": self.volume,
            "smallest_singular_value": self.smallest_singular_value,
            "isotropy": self.isotropy,
        }

    def __repr__(self) -> str:
        """One line."""
        return short_repr(self)

    def __str__(self) -> str:
        """A few lines for a person."""
        weakest = ", ".join(f"{x:.3g}" for x in np.round(self.weakest_wrench, 6) + 0.0)
        return "\n".join(
            [
                f"{self.n_contacts} contacts, {self.edges} edges per cone, "
                f"torque divided by {1e3 * self.length:.1f} mm",
                f"  force closure           {self.closure.reason}",
                f"  epsilon, discretised    {self.epsilon:.4f}",
                f"  epsilon, true cones     {self.epsilon_round}",
                f"  epsilon, L-infinity     {self.epsilon_linf}",
                f"  weakest against         ({weakest}) N, N m",
                f"  volume                  {self.volume:.3g}",
                f"  least singular value    {self.smallest_singular_value:.4f}",
                f"  isotropy                {self.isotropy:.4f}",
            ]
        )


def analyse(contacts: ContactSet, *, length: float | None = None, edges: int = 8) -> QualityReport:
    """Judge a set of contacts by every measure.

    Args:
        contacts: n contacts, from a plan, from MuJoCo or typed in.
        length: Torque is divided by it, m; by convention the radius of the object's bounding sphere
            about its centre of mass. There is no default: contacts do not tell how large an object
            is.
        edges: Edges per inscribed cone where cones are discretised, at least 3.

    Raises:
        ContactError: ``length`` is not given or not positive, or ``edges`` is not 3 to 64, or the
            hull has too many points.
    """
    check_contacts(contacts)
    if length is None:
        raise ContactError(
            "length is not given, by which torque is divided; give metres, by convention "
            "object.shape.bounding_radius (the quality of a plan is there already: plan.quality)"
        )
    check_hull(len(contacts), edges)
    hull = measure_hull(primitive_wrenches(contacts, edges, length=length))
    singular = singular_values(contacts, length=length)
    true_cones = epsilon_round(
        contacts, length=length, rel_tol=ROUND_REL_TOL, max_points=ROUND_POINTS
    )
    # The origin is inside both bodies or neither.
    bounded = true_cones
    if true_cones.upper > 0:
        bounded = epsilon_linf(
            contacts, length=length, rel_tol=LINF_REL_TOL, max_points=LINF_POINTS
        )
    return QualityReport(
        n_contacts=len(contacts),
        edges=edges,
        length=length,
        closure=force_closure(contacts, edges),
        epsilon=hull.epsilon,
        epsilon_round=true_cones,
        epsilon_linf=bounded,
        weakest_wrench=-hull.weakest * np.array([1.0, 1.0, 1.0, length, length, length]),
        volume=hull.volume,
        smallest_singular_value=float(singular[-1]),
        isotropy=float(singular[-1] / singular[0]) if singular[0] > 0 else 0.0,
    )


def closure_and_epsilon(
    contacts: ContactSet, *, length: float, edges: int = QUICK_EDGES
) -> tuple[bool, float]:
    """Force closure and L1 epsilon only, fast enough for every sample of a simulation.

    Where pyramids of ``QUICK_EDGES`` edges do not close, those of ``CLOSURE_EDGES``, which contain
    them, are asked: the verdict is the one of plans.

    A ball of radius epsilon in the hull of wrenches w_j proves closure by itself: the normalised
    min-weight is at least epsilon / (epsilon + max |w_j|). So the linear programme is asked only
    where epsilon is next to nothing. For the reason or a certificate, call ``force_closure``.

    Args:
        contacts: n contacts.
        length: Torque is divided by it, m.
        edges: Edges per inscribed cone, at least 3. Epsilon of 4 edges is up to a third below the
            true cones'.

    Returns:
        Whether the grasp is closed, as ``force_closure`` has it with as many edges, or with
        ``CLOSURE_EDGES`` where ``QUICK_EDGES`` were asked for; and epsilon of those that closed it,
        0 where nothing did.

    Raises:
        ContactError: ``length`` is not positive, or ``edges`` is below 3.
    """
    wrenches = primitive_wrenches(contacts, edges, length=length)
    epsilon = measure_hull(wrenches).epsilon
    longest = np.linalg.norm(wrenches, axis=0).max(initial=0.0)
    if epsilon > CLEARLY_CLOSED * longest:
        return True, epsilon
    closed = force_closure(contacts, edges).closed
    if not closed and edges == QUICK_EDGES:
        return closure_and_epsilon(contacts, length=length, edges=CLOSURE_EDGES)
    return closed, epsilon if closed else 0.0
