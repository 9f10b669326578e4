"""``build_force_problem``: from contacts, a wrench and a hand to a ``ForceProblem``."""

from __future__ import annotations

from typing import Required, TypedDict, get_args

import numpy as np
from numpy.typing import ArrayLike

from planner.actuation import Actuation
from planner.arrays import checked_number, finite_array, float_array, per_item
from planner.contacts import ContactSet
from planner.errors import ContactError, ObjectError
from planner.forces.contact_part import ContactPart
from planner.forces.costs import (
    add_change_cost,
    add_torque_cost,
    check_not_negative,
)
from planner.forces.friction import Cone, LimitSurface
from planner.forces.problem import ForceProblem
from planner.forces.transmission import HandPart
from planner.spatial import FloatArray

__all__ = ["ForceArguments", "LimitArguments", "build_force_problem", "gravity_wrench"]

ACTUATOR_COST = 1e-6
"""Cost of (actuator force / length)^2 beside that of (contact force)^2 (-): it decides where
contact forces are equal, and moves them by a millionth."""

STOP_COST = 1e-4
"""The same for stops: an actuator that can carry a torque carries 99 % of it."""

MIN_LENGTH = 1e-6
"""Contacts nearer than this to the centre (m) give no lever arm; the length is then 1 m."""

MIN_SCALE = 1e-9
"""If nothing above this (N) is asked for, residuals are judged against 1 N."""

EDGE_MARGIN = 0.2
"""Share of the friction (-) that forces keep from the cone's edge where that has a cost: friction
coefficients are seldom known better."""

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


class LimitArguments(TypedDict, total=False):
    """What forces may be and what they cost: ``build_force_problem`` and ``ForceLoop`` take it."""

    edges: int
    cone: Cone
    limit_surface: LimitSurface
    min_normal: ArrayLike
    max_normal: ArrayLike
    friction_scale: float
    tangential_cost: float
    edge_cost: float
    edge_margin: float


class ForceArguments(LimitArguments, total=False):
    """Arguments of ``build_force_problem``, explained there; all but ``wrench`` may be left out."""

    wrench: Required[ArrayLike]
    change_cost: float
    previous: ArrayLike | None
    torque_cost: float
    balance_cost: float | None
    jacobians: ArrayLike | None
    actuation: Actuation | None
    q: ArrayLike | None
    gravity_torque: ArrayLike | None


def build_force_problem(
    contacts: ContactSet,
    *,
    wrench: ArrayLike,
    edges: int = 8,
    cone: Cone = "inscribed",
    limit_surface: LimitSurface = "ellipsoid",
    min_normal: ArrayLike = 0.0,
    max_normal: ArrayLike = np.inf,
    friction_scale: float = 1.0,
    tangential_cost: float = 1.0,
    edge_cost: float = 0.0,
    edge_margin: float = EDGE_MARGIN,
    change_cost: float = 0.0,
    previous: ArrayLike | None = None,
    torque_cost: float = 0.0,
    balance_cost: float | None = None,
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
        cone: "inscribed" (what it allows the cone allows), "circumscribed", or "round": the
            second-order cone itself.
        limit_surface: "ellipsoid", where sliding takes from torsion, or "independent".
        min_normal: Least normal force, N, a number or (n,), >= 0. 0 asks for no grip.
        max_normal: Greatest normal force, N, a number or (n,). Unlimited unless given.
        friction_scale: Factor in (0, 1] on both frictions when the pyramids are made; keeps forces
            off the cone by a margin.
        tangential_cost: Cost of a squared tangential force beside a squared normal force, > 0. 1
            minimises sum |f|^2; more prefers forces near the normals.
        edge_cost: Cost of the squared normal force (N^2) by which a contact falls short of keeping
            ``edge_margin`` from its cone's edge, beside a squared normal force, >= 0.
        edge_margin: Share of the friction, in (0, 1), that costs ``edge_cost``.
        change_cost: Cost of a squared change of force from ``previous``, >= 0; torsion counts as
            in the cost on force.
        previous: Forces (n, 4) of the step before, in the contact frames; needed for
            ``change_cost``.
        torque_cost: Cost of a squared joint torque J^T f + gravity_torque over the squared length
            beside a squared normal force, >= 0; needs ``jacobians``.
        balance_cost: None for the balance as an equality; else the cost of its squared residual
            (N^2, torque over the length) beside a squared normal force, > 0.
        jacobians: (n, 3 or 6, nv), velocity of each contact point per joint velocity, linear rows
            first, in the contacts' axes. Soft contacts with torsion need all six.
        actuation: Limits the joint torques; needs ``jacobians`` and ``q``. Its springs help.
        q: Joints (nv,) at which the actuators' limits and the active stops are taken.
        gravity_torque: Joint torques (nv,) that hold the hand itself, N m; 0 unless given.

    Raises:
        ContactError: Shapes do not fit, NaN, or a value outside its range.
    """
    n = len(contacts)
    balance = finite_array("wrench", wrench, (6,))
    low, high = per_item("min_normal", min_normal, n), per_item("max_normal", max_normal, n)
    if (low < 0).any() or (low > high).any() or np.isinf(low).any():
        raise ContactError(
            f"min_normal is {min_normal!r} and max_normal {max_normal!r}; give "
            "0 <= min_normal <= max_normal, min_normal finite"
        )
    if not 0 < checked_number("friction_scale", friction_scale) <= 1:
        raise ContactError(f"friction_scale is {friction_scale}; give a factor in (0, 1]")
    checked_number("tangential_cost", tangential_cost, above=0.0)
    scaled = contacts.with_friction(
        friction_scale * contacts.mu, friction_scale * contacts.mu_torsion
    )
    if cone not in get_args(Cone):
        raise ContactError(f"cone is {cone!r}; use 'inscribed', 'circumscribed' or 'round'")
    check_not_negative("edge_cost", edge_cost)
    if not 0 < checked_number("edge_margin", edge_margin) < 1:
        raise ContactError(f"edge_margin is {edge_margin}; give a share in (0, 1)")
    if balance_cost is not None and not checked_number("balance_cost", balance_cost) > 0:
        raise ContactError(f"balance_cost is {balance_cost}; give a finite number > 0, or None")
    part = ContactPart(
        scaled,
        low,
        high,
        edges=edges,
        cone=cone,
        limit_surface=limit_surface,
        tangential_cost=tangential_cost,
        margin=edge_margin if edge_cost else 0.0,
    )
    arm = float(np.linalg.norm(contacts.positions - contacts.center, axis=1).max(initial=0.0))
    length = arm if arm > MIN_LENGTH else 1.0
    joint_map, gravity = _joint_map(contacts, jacobians, gravity_torque)
    hand = HandPart.of(joint_map, actuation, q, with_jacobians=jacobians is not None)
    na, ns = len(hand.actuators), len(hand.stops)
    asked = max([*np.abs(balance[:3]), *(np.abs(balance[3:]) / length), *low])
    row_scale = np.concatenate([np.ones(3), np.full(3 + len(hand.joints), 1 / length)])
    n_force, n_drive, excess = len(part.names), na + ns, part.excess
    residual = 0 if balance_cost is None else 6
    hand_cost = np.repeat([ACTUATOR_COST, STOP_COST], [na, ns]) / length**2
    extra_cost = [np.full(excess, edge_cost), (balance_cost or 0.0) * row_scale[:residual] ** 2]
    quadratic = np.diag(np.concatenate([part.cost, hand_cost, *extra_cost]))
    linear = np.zeros(len(quadratic))
    add_change_cost(quadratic, linear, part, contacts, change_cost, previous)
    add_torque_cost(quadratic, linear, joint_map, gravity, torque_cost, length)
    tail = np.zeros((6 + len(hand.joints), excess + residual))
    tail[:residual, excess:] = -np.eye(residual)
    wide = [np.zeros((len(rows), n_drive)) for rows in (part.faces, part.cones)]
    ends = [np.zeros((len(rows), residual)) for rows in (part.faces, part.cones)]
    faces, cones = (
        np.hstack([rows[:, :n_force], gap, rows[:, n_force:], end])
        for rows, gap, end in zip((part.faces, part.cones), wide, ends, strict=True)
    )
    free = np.full(residual, np.inf)
    return ForceProblem(
        contacts=contacts,
        wrench=balance,
        quadratic=quadratic,
        linear=linear,
        equality=np.block(
            [
                [contacts.grasp_map(), np.zeros((6, n_drive)), tail[:6]],
                [-joint_map[hand.joints], hand.drive, tail[6:]],
            ]
        ),
        equality_value=np.concatenate([-balance, gravity[hand.joints] - hand.passive]),
        faces=faces,
        cones=cones,
        cone_sizes=part.cone_sizes,
        lower=np.concatenate([part.lower, hand.limits[:, 0], np.zeros(ns + excess), -free]),
        upper=np.concatenate([part.upper, hand.limits[:, 1], np.full(ns + excess, np.inf), free]),
        column_names=(
            *part.names,
            *hand.column_names,
            *part.excess_names,
            *(f"residual {name}" for name in _WRENCH_ROWS[:residual]),
        ),
        equality_names=(*_WRENCH_ROWS, *hand.row_names),
        face_names=tuple(part.face_names),
        cone_names=tuple(part.cone_names),
        column_scale=np.concatenate(
            [part.unit, np.full(n_drive, length), np.ones(excess), 1 / row_scale[:residual]]
        ),
        row_scale=row_scale,
        length=length,
        force_scale=asked if asked > MIN_SCALE else 1.0,
        balance_cost=balance_cost,
        joints=hand.joints,
        actuators=hand.actuators,
        stops=hand.stops,
        joint_map=joint_map,
        gravity_torque=gravity,
        actuation=actuation,
        q=None if q is None else float_array("q", q, copy=True),
    )


def _joint_map(
    contacts: ContactSet, jacobians: ArrayLike | None, gravity_torque: ArrayLike | None
) -> tuple[FloatArray, FloatArray]:
    """J^T in contact components (nv, number of components) and gravity torque (nv,)."""
    n, dims = len(contacts), contacts.dims
    if jacobians is None:
        if gravity_torque is not None:
            raise ContactError("gravity_torque without jacobians; give both or neither")
        return np.zeros((0, sum(dims))), np.zeros(0)
    jac = float_array("jacobians", jacobians)
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
        np.zeros(nv)
        if gravity_torque is None
        else finite_array("gravity_torque", gravity_torque, (nv,))
    )
    return np.hstack(columns), gravity
