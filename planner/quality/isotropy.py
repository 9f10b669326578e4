"""How evenly the grasp map turns contact forces into wrenches: its singular values.

The grasp map G of ``planner.contacts`` is taken with every row and every column in newtons: torque
on the object and torsional moments at the contacts are both divided by the characteristic length.
Friction and the sign of forces do not enter, so these say how well placed the contacts are, not
whether they close the grasp. (Roa and Suarez 2015, "Grasp quality measures: review", section 2.1.)
"""

from __future__ import annotations

import numpy as np

from planner.contacts import ContactSet
from planner.quality.cones import RoundCones
from planner.spatial import FloatArray


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
