"""``build_force_problem``: from contacts, a wrench and a hand to a ``ForceProblem``."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from planner.actuation import Actuation
from planner.contacts import ContactSet
from planner.errors import ContactError, ObjectError
from planner.forces.friction import Pyramid, pyramid_faces
from planner.forces.problem import ForceProblem, contact_names
from planner.forces.transmission import HandPart
from planner.spatial import FloatArray

__all__ = ["build_force_problem", "gravity_wrench"]

ACTUATOR_COST = 1e-6
"""Cost of (actuator force / length)^2 beside that of (contact force)^2 (-): it decides where
contact forces are equal, and moves them by a millionth."""

STOP_COST = 1e-4
"""The same for stops: an actuator that can carry a torque carries 99 % of it."""

MIN_LENGTH = 1e-6
"""Contacts nearer than this to the centre (m) give no lever arm; the length is then 1 m."""

MIN_SCALE = 1e-9
"""If nothing above this (N) is asked for, residuals are judged against 1 N."""

_COMPONENTS = ("f_n", "f_t1", "f_t2", "tau_n")
_WRENCH_ROWS = ("force x", "force y", "force z", "torque x", "torque y", "torque z")


def gravity_wrench(mass: float, gravity: ArrayLike) -> FloatArray:
    """Wrench (6,) of gravity (3,) in m/s2 on a mass in kg about its centre: [m g; 0].

    Raises:
        ObjectError: The mass is negative or not finite, or gravity is not three finite numbers.
    """
    g = np.asarray(gravity, dtype=np.float64)
    if g.shape != (3,) or not np.isfinite(g).all():
        raise ObjectError(f"gravity is {gravity!r}; give three finite numbers in m/s2")
    if not (np.isfinite(mass) and mass >= 0):
        raise ObjectError(f"the mass is {mass}; give a number >= 0 in kg")
    return np.concatenate([mass * g, np.zeros(3)])


def build_force_problem(
    contacts: ContactSet,
    *,
    wrench: ArrayLike,
    edges: int = 8,
    cone: Pyramid = "inscribed",
    min_normal: ArrayLike = 0.0,
    max_normal: ArrayLike = np.inf,
    friction_scale: float = 1.0,
    tangential_cost: float = 1.0,
    jacobians: ArrayLike | None = None,
    actuation: Actuation | None = None,
    q: ArrayLike | None = None,
    gravity_torque: ArrayLike | None = None,
) -> ForceProblem:
    """Build the quadratic programme of contact forces; nothing is solved.

    Args:
        contacts: n contacts; 0 is allowed. Their own forces are not read.
        wrench: External wrench (6,) on the object to be balanced, G f + wrench = 0: N and N m,
            about ``contacts.center``, in the contacts' axes.
        edges: Sides of each friction pyramid, at least 3. Eight lose at most 8 % of the sliding
            friction; sliding and torsion together lose more, up to 29 %.
        cone: "inscribed" (what it allows the cone allows) or "circumscribed".
        min_normal: Least normal force, N, a number or (n,), >= 0. 0 asks for no grip.
        max_normal: Greatest normal force, N, a number or (n,). Unlimited unless given.
        friction_scale: Factor in (0, 1] on both frictions when the pyramids are made; keeps forces
            off the cone by a margin.
        tangential_cost: Cost of a squared tangential force beside a squared normal force, > 0. 1
            minimises sum |f|^2; more prefers forces near the normals.
        jacobians: (n, 3 or 6, nv), velocity of each contact point per joint velocity, linear rows
            first, in the contacts' axes. Soft contacts with torsion need all six.
        actuation: Limits the joint torques; needs ``jacobians`` and ``q``. Its springs help.
        q: Joints (nv,) at which the actuators' limits and the active stops are taken.
        gravity_torque: Joint torques (nv,) that hold the hand itself, N m; 0 unless given.

    Raises:
        ContactError: Shapes do not fit, NaN, or a value outside its range.
    """
    n = len(contacts)
    balance = _array("wrench", wrench, (6,))
    low, high = _per_contact("min_normal", min_normal, n), _per_contact("max_normal", max_normal, n)
    if (low < 0).any() or (low > high).any() or np.isinf(low).any():
        raise ContactError(
            f"min_normal is {min_normal!r} and max_normal {max_normal!r}; give "
            "0 <= min_normal <= max_normal, min_normal finite"
        )
    if not 0 < friction_scale <= 1:
        raise ContactError(f"friction_scale is {friction_scale}; give a factor in (0, 1]")
    if not 0 < tangential_cost < np.inf:
        raise ContactError(f"tangential_cost is {tangential_cost}; give a finite number > 0")
    scaled = contacts.with_friction(
        friction_scale * contacts.mu, friction_scale * contacts.mu_torsion
    )
    part = _ContactPart(scaled, low, high, edges, cone, tangential_cost)
    arm = float(np.linalg.norm(contacts.positions - contacts.center, axis=1).max(initial=0.0))
    length = arm if arm > MIN_LENGTH else 1.0
    joint_map, gravity = _joint_map(contacts, jacobians, gravity_torque)
    hand = HandPart.of(joint_map, actuation, q, with_jacobians=jacobians is not None)
    na, ns = len(hand.actuators), len(hand.stops)
    asked = max([*np.abs(balance[:3]), *(np.abs(balance[3:]) / length), *low])
    return ForceProblem(
        contacts=contacts,
        wrench=balance,
        cost=np.concatenate(
            [part.cost, np.repeat([ACTUATOR_COST, STOP_COST], [na, ns]) / length**2]
        ),
        equality=np.block(
            [
                [contacts.grasp_map(), np.zeros((6, na + ns))],
                [-joint_map[hand.joints], hand.drive],
            ]
        ),
        equality_value=np.concatenate([-balance, gravity[hand.joints] - hand.passive]),
        faces=np.hstack([part.faces, np.zeros((len(part.faces), na + ns))]),
        lower=np.concatenate([part.lower, hand.limits[:, 0], np.zeros(ns)]),
        upper=np.concatenate([part.upper, hand.limits[:, 1], np.full(ns, np.inf)]),
        column_names=(*part.names, *hand.column_names),
        equality_names=(*_WRENCH_ROWS, *hand.row_names),
        face_names=tuple(part.face_names),
        column_scale=np.concatenate([part.unit, np.full(na + ns, length)]),
        row_scale=np.concatenate([np.ones(3), np.full(3 + len(hand.joints), 1 / length)]),
        length=length,
        force_scale=asked if asked > MIN_SCALE else 1.0,
        joints=hand.joints,
        actuators=hand.actuators,
        stops=hand.stops,
        joint_map=joint_map,
        gravity_torque=gravity,
        actuation=actuation,
        q=None if q is None else np.array(q, dtype=np.float64),
    )


class _ContactPart:
    """Columns of the contact forces: names, cost, unit, bounds, and their friction faces."""

    def __init__(
        self,
        contacts: ContactSet,
        low: FloatArray,
        high: FloatArray,
        edges: int,
        cone: Pyramid,
        tangential_cost: float,
    ) -> None:
        """Lay them out contact by contact; friction is that of ``contacts``."""
        size = sum(contacts.dims)
        self.names: list[str] = []
        self.cost, self.unit = np.ones(size), np.ones(size)
        self.lower, self.upper = np.full(size, -np.inf), np.full(size, np.inf)
        self.face_names: list[str] = []
        rows = [np.zeros((0, size))]
        labels = contact_names(contacts)
        for i, dim in enumerate(contacts.dims):
            at = len(self.names)
            self.names += [f"{labels[i]} {c}" for c in _COMPONENTS[:dim]]
            self.lower[at], self.upper[at] = low[i], high[i]
            self.cost[at + 1 : at + dim] = tangential_cost
            mu = float(contacts.mu[i]) if dim >= 3 else 0.0
            twist = float(contacts.mu_torsion[i]) if dim == 4 else 0.0
            if mu == 0.0:
                self._pin(at + 1, min(at + 3, at + dim))
            if dim == 4 and twist == 0.0:
                self._pin(at + 3, at + 4)
            elif dim == 4:
                # A torsion counts like the normal force that its friction needs.
                self.unit[at + 3] = twist
                self.cost[at + 3] /= twist**2
            faces = pyramid_faces(mu, twist, edges, cone)
            block = np.zeros((len(faces), size))
            block[:, at : at + dim] = faces[:, :dim]
            rows.append(block)
            self.face_names += [f"friction of {labels[i]}"] * len(faces)
        self.faces = np.vstack(rows)

    def _pin(self, begin: int, end: int) -> None:
        self.lower[begin:end] = self.upper[begin:end] = 0.0


def _array(what: str, value: Any, shape: tuple[int, ...]) -> FloatArray:
    """A float array of a shape, finite.

    Raises:
        ContactError: It is not.
    """
    array = np.array(value, dtype=np.float64)
    if array.shape != shape:
        raise ContactError(f"{what} has shape {array.shape}; give {shape}")
    if not np.isfinite(array).all():
        raise ContactError(f"{what} holds NaN or infinity; give finite numbers")
    return array


def _per_contact(what: str, value: ArrayLike, n: int) -> FloatArray:
    """A number or (n,) as (n,); infinity is allowed.

    Raises:
        ContactError: Another shape, or NaN.
    """
    array = np.asarray(value, dtype=np.float64)
    if array.shape not in ((), (n,)):
        raise ContactError(f"{what} has shape {array.shape}; give a number or ({n},)")
    if np.isnan(array).any():
        raise ContactError(f"{what} holds NaN; give numbers in N")
    return np.broadcast_to(array, (n,))


def _joint_map(
    contacts: ContactSet, jacobians: ArrayLike | None, gravity_torque: ArrayLike | None
) -> tuple[FloatArray, FloatArray]:
    """J^T in contact components (nv, number of components) and gravity torque (nv,)."""
    n, dims = len(contacts), contacts.dims
    if jacobians is None:
        if gravity_torque is not None:
            raise ContactError("gravity_torque without jacobians; give both or neither")
        return np.zeros((0, sum(dims))), np.zeros(0)
    jac = np.array(jacobians, dtype=np.float64)
    if jac.ndim != 3 or jac.shape[0] != n or jac.shape[1] not in (3, 6):
        raise ContactError(f"jacobians have shape {jac.shape}; give ({n}, 3 or 6, nv)")
    if not np.isfinite(jac).all():
        raise ContactError("jacobians hold NaN or infinity; give finite numbers")
    nv = jac.shape[2]
    columns = [np.zeros((nv, 0))]
    for i, dim in enumerate(dims):
        frame = contacts.frames[i]
        columns.append(jac[i, :3].T @ frame[:, : min(dim, 3)])
        if dim == 4:
            if jac.shape[1] == 3 and contacts.mu_torsion[i] > 0:
                raise ContactError(
                    f"contact {i} transmits torsion, but its Jacobian has linear rows only; give "
                    "jacobians of shape (n, 6, nv) with the angular rows below"
                )
            angular = jac[i, 3:].T @ frame[:, :1] if jac.shape[1] == 6 else np.zeros((nv, 1))
            columns.append(angular)
    gravity = (
        np.zeros(nv) if gravity_torque is None else _array("gravity_torque", gravity_torque, (nv,))
    )
    return np.hstack(columns), gravity
