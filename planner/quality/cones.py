"""Friction cones as wrenches: their edges, and their exact extremal points.

With g the pull-back of a wrench direction u to the contact frame, the friction law of
``planner.contacts`` is, for a unit normal component, the ellipsoid

    f = [1, mu a, mu b, mu_torsion c],    a^2 + b^2 + c^2 <= 1,

flattened where a friction coefficient is zero or the model does not transmit the component. Two
polyhedra stand in for it, k edges being a number of the caller's choice:

inscribed
    k edges on the cone in the tangent plane and, where there is torsional friction, the two edges
    n +- mu_torsion. All are points of the cone, so what the edges can resist the cone can too.
circumscribed
    The k tangential edges pushed out by 1/cos(pi/k) and, where there is torsional friction, each of
    them with torsion +mu_torsion and with -mu_torsion (2k edges): a prism. It holds the ellipsoid:
    a k-gon of circumradius 1/cos(pi/k) has inradius 1, so it holds the disc a^2 + b^2 <= 1, and
    a^2 + b^2 + c^2 <= 1 implies both a^2 + b^2 <= 1 and |c| <= 1. Pure sliding at the middle of a
    side and pure torsion touch it, so it is as tight as an outer polyhedron can be there. What
    the edges cannot resist the cone cannot resist.

A friction of zero leaves no copies behind: a contact without any friction has one edge, its normal,
and one with torsional friction only has two, n +- mu_torsion. The weight that a copy would carry is
carried by the one edge, so nothing but the number of columns changes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from planner.arrays import checked_count, float_array
from planner.contacts import MIN_EDGES, MOST_EDGES, ContactSet
from planner.errors import ContactError
from planner.spatial import FloatArray

__all__ = ["Cone", "RoundCones", "cone_edges", "contact_wrenches", "primitive_wrenches"]

Cone: TypeAlias = Literal["inscribed", "circumscribed"]
EdgeUnit: TypeAlias = Literal["normal", "length"]

SHORTEST, LONGEST = 1e-6, 1e6
"""Range of a characteristic length, m: beyond it forces and torques drown each other."""


def cone_edges(
    mu: float, mu_torsion: float, edges: int = 8, *, cone: Cone = "inscribed", phase: float = 0.0
) -> FloatArray:
    """Edges of one polyhedral friction cone in the contact frame, unit normal component.

    Args:
        mu: Sliding friction (-); 0 for a frictionless contact.
        mu_torsion: Torsional friction (m); 0 for all but a soft contact.
        edges: Number k of edges in the tangent plane, at least 3.
        cone: "inscribed" or "circumscribed", see the module.
        phase: Angle of the first edge from tangent1 towards tangent2, rad.

    Returns:
        (4, m), rows f_n = 1, f_t1, f_t2 (-) and tau_n (m); m is 1, 2, k, k + 2 or 2 k.

    Raises:
        ContactError: ``edges`` is not 3 to 512, or ``cone`` is unknown.
    """
    _check_edges(edges)
    if cone not in ("inscribed", "circumscribed"):
        raise ContactError(f"cone is {cone!r}; use 'inscribed' or 'circumscribed'")
    angle = phase + 2 * np.pi * np.arange(edges) / edges
    reach = mu if cone == "inscribed" else mu / np.cos(np.pi / edges)
    one, zero = np.ones(edges), np.zeros(edges)
    sliding = np.array([one, reach * np.cos(angle), reach * np.sin(angle), zero])  # (4, k)
    twist = np.array([[1, 1], [0, 0], [0, 0], [mu_torsion, -mu_torsion]], dtype=np.float64)
    if mu == 0.0:
        return twist if mu_torsion > 0.0 else twist[:, :1]
    if mu_torsion == 0.0:
        return sliding
    if cone == "inscribed":
        return np.hstack([sliding, twist])
    lift = np.zeros_like(sliding)
    lift[3] = mu_torsion
    return np.hstack([sliding + lift, sliding - lift])


def contact_wrenches(
    contacts: ContactSet,
    edges: int = 8,
    *,
    cone: Cone = "inscribed",
    length: float = 1.0,
    phase: float = 0.0,
    unit: EdgeUnit = "normal",
) -> list[FloatArray]:
    """Primitive wrenches contact by contact: n arrays (6, m_i), see ``primitive_wrenches``."""
    if unit not in ("normal", "length"):
        raise ContactError(f"unit is {unit!r}; use 'normal' or 'length'")
    cones = RoundCones.of(contacts, length)
    groups = []
    for wrench_map, (mu, _, mu_torsion) in zip(cones.maps, cones.semi_axes, strict=True):
        edge = cone_edges(mu, mu_torsion, edges, cone=cone, phase=phase)
        if unit == "length":
            edge = edge / np.linalg.norm(edge[:3], axis=0)
        groups.append(wrench_map @ edge)
    return groups


def primitive_wrenches(
    contacts: ContactSet,
    edges: int = 8,
    *,
    cone: Cone = "inscribed",
    length: float = 1.0,
    phase: float = 0.0,
    unit: EdgeUnit = "normal",
) -> FloatArray:
    """Wrenches of the edges of all friction cones, one column per edge.

    Args:
        contacts: n contacts.
        edges: Number k of edges per contact in its tangent plane, at least 3.
        cone: "inscribed" or "circumscribed", see the module.
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
        maps[:, 3:, :3] = np.cross(arms[:, :, None], contacts.frames, axis=1) / length
        maps[:, 3:, 3] = contacts.normals / length
        maps *= (np.arange(4) < dims[:, None])[:, None, :]
        sliding = contacts.mu * (dims >= 3)
        torsion = contacts.mu_torsion * (dims == 4)
        return cls(maps=maps, semi_axes=np.stack([sliding, sliding, torsion], axis=1))

    def extremes(self, directions: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Furthest point of each cone's section along given directions.

        Args:
            directions: (q, 6).

        Returns:
            Values u . w (q, n) and the wrenches w (q, n, 6) where they are reached. The closed form
            is g_n + |(mu g_t1, mu g_t2, mu_torsion g_tau)|, with g the pull-back of u.
        """
        pulled = np.swapaxes(directions @ self.maps, 0, 1)  # (q, n, 4)
        stretched = pulled[:, :, 1:] * self.semi_axes
        norm = np.linalg.norm(stretched, axis=2, keepdims=True)
        ball = np.divide(stretched, norm, out=np.zeros_like(stretched), where=norm > 0)
        force = np.concatenate([np.ones_like(norm), ball * self.semi_axes], axis=2)  # (q, n, 4)
        wrenches = np.swapaxes(force, 0, 1) @ np.swapaxes(self.maps, 1, 2)  # (n, q, 6)
        return pulled[:, :, 0] + norm[:, :, 0], np.swapaxes(wrenches, 0, 1)


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


def _check_edges(edges: int) -> None:
    checked_count("the number of edges per friction cone", edges, least=MIN_EDGES, most=MOST_EDGES)
