"""Friction cones as wrenches on the object: their edges, and their exact extremal points.

The cones are those of ``planner.contacts.friction``. Where a friction is zero, the weight that
copies of an edge would carry is carried by the one edge: only the number of columns changes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal, TypeAlias

import numpy as np

from planner.arrays import float_array
from planner.contacts import ContactSet, check_contacts
from planner.contacts.friction import Pyramid, check_edges, cone_edges, cone_support
from planner.errors import ContactError, shown
from planner.spatial import FloatArray, skew

EdgeUnit: TypeAlias = Literal["normal", "length"]

SHORTEST, LONGEST = 1e-6, 1e6
"""Range of a characteristic length, m: beyond it forces and torques drown each other."""


def contact_wrenches(
    contacts: ContactSet,
    edges: int = 8,
    *,
    cone: Pyramid = "inscribed",
    length: float = 1.0,
    phase: float = 0.0,
    unit: EdgeUnit = "normal",
) -> list[FloatArray]:
    """Primitive wrenches contact by contact: n arrays (6, m_i), see ``primitive_wrenches``."""
    check_contacts(contacts)
    check_edges(edges, cone)
    if unit not in ("normal", "length"):
        raise ContactError(f"unit is {shown(unit)}; use 'normal' or 'length'")
    cones = RoundCones.of(contacts, length)
    groups = []
    for wrench_map, (mu, _, mu_torsion) in zip(cones.maps, cones.semi_axes, strict=True):
        edge = _edges(float(mu), float(mu_torsion), edges, cone, phase, unit)
        groups.append(wrench_map @ edge)
    return groups


@lru_cache(256)
def _edges(
    mu: float, mu_torsion: float, edges: int, cone: Pyramid, phase: float, unit: EdgeUnit
) -> FloatArray:
    """Edges of a cone (4, m), the same for most contacts of a grasp and most grasps of a task."""
    edge = cone_edges(mu, mu_torsion, edges, cone=cone, phase=phase)
    if unit == "length":
        edge = edge / np.linalg.norm(edge[:3], axis=0)
    edge.flags.writeable = False
    return edge


def primitive_wrenches(
    contacts: ContactSet,
    edges: int = 8,
    *,
    cone: Pyramid = "inscribed",
    length: float = 1.0,
    phase: float = 0.0,
    unit: EdgeUnit = "normal",
) -> FloatArray:
    """Wrenches of the edges of all friction cones, one column per edge.

    Args:
        contacts: n contacts.
        edges: Number k of edges per contact in its tangent plane, at least 3.
        cone: "inscribed" or "circumscribed".
        length: Torque rows are divided by it, m.
        phase: Angle of the first edge from tangent1, rad.
        unit: "normal" gives every edge a unit normal component, "length" a force of unit length.

    Returns:
        W, (6, m), [force (-); torque about ``contacts.center`` / length (-)] per unit of force.

    Raises:
        ContactError: ``edges``, ``cone``, ``length`` or ``unit`` is not usable.
    """
    groups = contact_wrenches(contacts, edges, cone=cone, length=length, phase=phase, unit=unit)
    return np.hstack([np.zeros((6, 0)), *groups])


@dataclass(frozen=True, kw_only=True)
class RoundCones:
    """The true cones at unit normal component, as linear images of balls.

    Attributes:
        maps: (n, 6, 4), [f_n, f_t1, f_t2, tau_n] of a contact -> wrench, torque rows divided by the
            characteristic length. Columns that a contact does not transmit are zero.
        semi_axes: (n, 3), mu (-), mu (-), mu_torsion (m) as far as the contact's model has them.
    """

    maps: FloatArray
    semi_axes: FloatArray

    @classmethod
    def of(cls, contacts: ContactSet, length: float) -> RoundCones:
        """The cones of a set, torque divided by ``length`` (m).

        Raises:
            ContactError: ``length`` is not a positive number.
        """
        check_length(length)
        dims = np.array(contacts.dims, dtype=int)
        maps = np.zeros((len(contacts), 6, 4))
        # (n, 3, 3) forces; torques are arm x column; tau_n acts along the normal.
        arms = contacts.positions - contacts.center
        maps[:, :3, :3] = contacts.frames
        maps[:, 3:, :3] = skew(arms / length) @ contacts.frames
        maps[:, 3:, 3] = contacts.normals / length
        maps *= (np.arange(4) < dims[:, None])[:, None, :]
        return cls(maps=maps, semi_axes=contacts.friction[:, [0, 0, 1]])

    def extremes(self, directions: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Furthest point of each cone's section along given directions.

        Args:
            directions: (q, 6).

        Returns:
            Values u . w (q, n), and the wrenches w (q, n, 6) where they are reached
            (``cone_support``).
        """
        pulled = np.swapaxes(directions @ self.maps, 0, 1)  # (q, n, 4)
        values, force = cone_support(pulled, self.semi_axes)  # (q, n), (q, n, 4)
        wrenches = np.swapaxes(force, 0, 1) @ np.swapaxes(self.maps, 1, 2)  # (n, q, 6)
        return values, np.swapaxes(wrenches, 0, 1)


def check_length(length: float) -> None:
    """Refuse a characteristic length that is not a positive number of metres.

    Raises:
        ContactError: It is not.
    """
    given = float_array("the characteristic length", length)
    if given.shape != () or not SHORTEST <= given <= LONGEST:
        raise ContactError(
            f"the characteristic length is {length}; give a positive number of metres "
            f"from {SHORTEST:g} to {LONGEST:g}, for example the radius of the object's bounding "
            "sphere about its centre of mass"
        )
