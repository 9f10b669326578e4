"""How far the wrenches that a grasp can apply reach along single directions, for charts."""

from __future__ import annotations

import numpy as np

from planner.contacts import ContactSet
from planner.errors import ContactError
from planner.quality.ball import check_hull
from planner.quality.cones import primitive_wrenches
from planner.spatial import FloatArray


def wrench_reach(
    contacts: ContactSet, directions: FloatArray, *, length: float, edges: int = 8
) -> FloatArray:
    """The largest wrench along each direction that contacts apply with normal forces of sum 1.

    The wrench of a disturbance that they resist is its opposite.

    Args:
        contacts: n contacts with force closure.
        directions: (k, 6), [force; torque divided by ``length`` and about the centre], not 0.
        length: Torque is divided by it, m.
        edges: Edges per inscribed cone.

    Returns:
        (k,), in lengths of the directions; per newton of total normal force.

    Raises:
        ContactError: The contacts have no force closure, so that the hull does not hold 0.
    """
    from planner.system.scipy_parts import ConvexHull, QhullError  # here: SciPy loads slowly

    check_hull(len(contacts), edges)
    wrenches = primitive_wrenches(contacts, edges, length=length)
    try:
        # joggled: points in special position are common, and a chart shows three digits
        facets = ConvexHull(wrenches.T, qhull_options="QJ").equations
    except QhullError as error:
        raise ContactError(f"{NOTHING}: the wrenches are in a hyperplane") from error
    offsets = -facets[:, -1]
    if offsets.min() <= 0:
        raise ContactError(f"{NOTHING}: 0 is not inside the hull of wrenches")
    along = np.asarray(directions, dtype=np.float64) @ facets[:, :-1].T  # (k, facets)
    reach: FloatArray = np.min(np.where(along > 0, offsets / np.maximum(along, TINY), np.inf), 1)
    return reach


NOTHING = "contacts without force closure have no reach in every direction"
TINY = 1e-300
"""Against division by 0."""
