"""Costs of a force problem beyond the squares of forces, and the checks of its arguments."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from planner.arrays import checked_number, finite_array
from planner.contacts import ContactSet
from planner.errors import ContactError
from planner.forces.contact_part import ContactPart
from planner.spatial import FloatArray

__all__ = ["add_change_cost", "add_torque_cost", "check_not_negative"]


def add_change_cost(
    quadratic: FloatArray,
    linear: FloatArray,
    part: ContactPart,
    contacts: ContactSet,
    cost: float,
    previous: ArrayLike | None,
) -> None:
    """Add cost/2 |(f - previous) / unit|^2.

    Raises:
        ContactError: No previous forces for a cost, or a cost below 0.
    """
    check_not_negative("change_cost", cost)
    if cost == 0.0:
        return
    if previous is None:
        raise ContactError(
            "change_cost is the cost of a change from previous; give previous (n, 4)"
        )
    forces = finite_array("previous", previous, (len(contacts), 4))
    before = np.concatenate([f[:d] for f, d in zip(forces, contacts.dims, strict=True)])
    weight = cost / part.unit**2
    n = len(before)
    quadratic[range(n), range(n)] += weight
    linear[:n] -= weight * before


def add_torque_cost(
    quadratic: FloatArray,
    linear: FloatArray,
    joint_map: FloatArray,
    gravity: FloatArray,
    cost: float,
    length: float,
) -> None:
    """Add cost/2 |(J^T f + gravity) / length|^2.

    Raises:
        ContactError: No Jacobians for a cost, or a cost below 0.
    """
    check_not_negative("torque_cost", cost)
    if cost == 0.0:
        return
    nv, n = joint_map.shape
    if nv == 0:
        raise ContactError("torque_cost is a cost of joint torques; give jacobians")
    quadratic[:n, :n] += cost / length**2 * (joint_map.T @ joint_map)
    linear[:n] += cost / length**2 * (joint_map.T @ gravity)


def check_not_negative(name: str, cost: float) -> None:
    """Refuse a cost below 0.

    Raises:
        ContactError: It is, or is not finite.
    """
    checked_number(name, cost, least=0.0)
