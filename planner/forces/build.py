"""``build_force_problem``: from contacts, a wrench and a hand to a ``ForceProblem``.

``QuadraticCost``: what forces cost beside their squares, one object for each reason.

    1/2 f'P f + q'f

f are the contact force components of all contacts one after the other: f_n, f_t1, f_t2 (N) and
tau_n (N m), as far as each contact's model has them (``ContactSet.dims``), in the contact frames.
``distribute_forces`` and ``ForceLoop`` take a list of such costs. A new one is a new object::

    spread = QuadraticCost.of_residual(matrix, target, weight=2.0, name="equal normal forces")
    distribute_forces(contacts, wrench=weight, costs=[spread])
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Required, TypedDict, get_args

import numpy as np
from numpy.typing import ArrayLike

from planner.arrays import checked_number, finite_array, float_array, per_item
from planner.contacts import Cone, ContactSet, check_contacts
from planner.contacts.friction import check_edges
from planner.errors import ContactError, ObjectError, shown
from planner.forces.limits import TorqueCase, TorqueLimits, friction_part, loaded_rows
from planner.forces.problem import ForceProblem
from planner.joints.actuation import Actuation
from planner.spatial import FloatArray
from planner.system.threads import made_once

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


EXTRA_COST = 1e-4
"""Cost of (force / length)^2 of an actuator or stop that repeats others, beside that of (contact
force)^2 (-): it decides where contact forces are equal."""

MIN_LENGTH = 1e-6
"""Contacts nearer than this to the centre (m) give no lever arm; the length is then 1 m."""

MIN_SCALE = 1e-9
"""If nothing above this (N) is asked for, residuals are judged against 1 N."""

EDGE_MARGIN = 0.2
"""Share of the friction (-) that forces keep from the cone's edge where that has a cost: friction
coefficients are seldom known better."""

CONES = get_args(Cone)
"""Names of pyramids and cones."""

_WRENCH_ROWS = ("force x", "force y", "force z", "torque x", "torque y", "torque z")


def gravity_wrench(mass: float, gravity: ArrayLike) -> FloatArray:
    """Wrench (6,) of gravity (3,) in m/s2 on a mass in kg about its centre: [m g; 0].

    Raises:
        ObjectError: The mass is negative or not finite, or gravity is not three finite numbers.
    """
    g = np.asarray(gravity, dtype=np.float64)
    if g.shape != (3,) or not np.isfinite(g).all():
        raise ObjectError(f"gravity is {shown(gravity)}; give three finite numbers in m/s2")
    if not (np.isfinite(mass) and mass >= 0):
        raise ObjectError(f"the mass is {mass}; give a number >= 0 in kg")
    return np.concatenate([mass * g, np.zeros(3)])


class LimitArguments(TypedDict, total=False):
    """What forces may be and what they cost: ``build_force_problem`` and ``ForceLoop`` take it."""

    edges: int
    cone: Cone
    min_normal: ArrayLike
    max_normal: ArrayLike
    friction_scale: float
    edge_cost: float
    costs: Sequence[QuadraticCost]


class ForceArguments(LimitArguments, total=False):
    """Arguments of ``build_force_problem``, explained there; all but ``wrench`` may be left out."""

    wrench: Required[ArrayLike]
    jacobians: ArrayLike | None
    actuation: Actuation | None
    q: ArrayLike | None
    gravity_torque: ArrayLike | None
    contact_compliance: ArrayLike | None


def build_force_problem(
    contacts: ContactSet,
    *,
    wrench: ArrayLike,
    edges: int = 8,
    cone: Cone = "inscribed",
    min_normal: ArrayLike = 0.0,
    max_normal: ArrayLike = np.inf,
    friction_scale: float = 1.0,
    edge_cost: float = 0.0,
    costs: Sequence[QuadraticCost] = (),
    jacobians: ArrayLike | None = None,
    actuation: Actuation | None = None,
    q: ArrayLike | None = None,
    gravity_torque: ArrayLike | None = None,
    contact_compliance: ArrayLike | None = None,
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
        min_normal: Least normal force, N, a number or (n,), >= 0. 0 asks for no grip.
        max_normal: Greatest normal force, N, a number or (n,). Unlimited unless given.
        friction_scale: Factor in (0, 1] on both frictions when the pyramids are made; keeps forces
            off the cone by a margin.
        edge_cost: Cost of the squared normal force (N^2) by which a contact falls short of keeping
            ``EDGE_MARGIN`` from its cone's edge, beside a squared normal force, >= 0.
        costs: What forces cost beside their squares; a torsion counts in those like the normal
            force that its friction needs.
        jacobians: (n, 3 or 6, nv), velocity of each contact point per joint velocity, linear rows
            first, in the contacts' axes. Soft contacts with torsion need all six.
        actuation: Limits the joint torques; needs ``jacobians`` and ``q``. Its springs help.
        q: Joints (nv,) at which the actuators' limits and the active stops are taken.
        gravity_torque: Joint torques (nv,) that hold the hand itself, N m; 0 unless given.
        contact_compliance: How contacts give way, m/N, a number for all or one per force component
            (torsion over the square of its ``column_scale``); only ratios count. Internal forces
            that load no joint are then those that compliance brings about
            (``planner.forces.compliance``); None lets them be chosen. Needs ``jacobians``.

    Raises:
        ContactError: Shapes do not fit, NaN, or a value outside its range.
    """
    check_contacts(contacts)
    n = len(contacts)
    balance = finite_array("wrench", wrench, (6,))
    least, most = per_item("min_normal", min_normal, n), per_item("max_normal", max_normal, n)
    if (least < 0).any() or (least > most).any() or np.isinf(least).any():
        raise ContactError(
            f"min_normal is {shown(min_normal)} and max_normal {shown(max_normal)}; give "
            "0 <= min_normal <= max_normal, min_normal finite"
        )
    if not 0 < checked_number("friction_scale", friction_scale) <= 1:
        raise ContactError(f"friction_scale is {friction_scale}; give a factor in (0, 1]")
    if cone not in CONES:
        raise ContactError(f"cone is {shown(cone)}; use 'inscribed', 'circumscribed' or 'round'")
    if cone != "round":
        check_edges(edges, cone)
    checked_number("edge_cost", edge_cost, least=0.0)
    friction = friction_scale * contacts.friction
    margin = EDGE_MARGIN if edge_cost else 0.0
    part = friction_part(contacts.models, contacts.fingers, friction.tobytes(), edges, cone, margin)
    lower, upper = part.lower.copy(), part.upper.copy()
    lower[part.normal], upper[part.normal] = least, most
    arms = contacts.positions - contacts.center
    arm = math.sqrt((arms * arms).sum(axis=1).max(initial=0.0))
    length = arm if arm > MIN_LENGTH else 1.0
    joint_map, gravity = _joint_map(contacts, jacobians, gravity_torque)
    limits = _torque_limits(actuation, joint_map, q, gravity, jacobians is not None)
    torques = np.zeros((2, len(joint_map) if limits else 0))
    if limits is not None and q is not None:
        limits.at(np.asarray(q, dtype=np.float64), torques)
    nf, excess = len(part.names), n if edge_cost else 0
    z = np.zeros((0, nf)) if limits is None else limits.case.rows @ joint_map
    extra = np.zeros((0, 0)) if limits is None else limits.case.extra_rows
    torque_rows = np.flatnonzero(loaded_rows(z, extra))
    ne, mf, mt = extra.shape[1], len(part.faces), len(torque_rows)
    shared = np.zeros((0, nf))
    if contact_compliance is not None:
        from planner.forces.compliance import passive_rows  # here: fingertips share no joints

        shared = passive_rows(contacts, joint_map, actuation, contact_compliance, part.unit)
    mp = len(shared)
    nx = nf + excess + ne
    rows = np.zeros((6 + mf + mp + mt, nx))
    rows[:6, :nf] = contacts.grasp_map()
    rows[6 : 6 + mf, : nf + excess] = part.faces
    rows[6 + mf : 6 + mf + mp, :nf] = shared
    end = 6 + mf + mp
    rows[end:, :nf], rows[end:, nx - ne :] = z[torque_rows], extra[torque_rows]
    low = np.concatenate([-balance, np.full(mf, -np.inf), np.zeros(mp), torques[0, torque_rows]])
    high = np.concatenate([-balance, np.zeros(mf + mp), torques[1, torque_rows]])
    extra_low, extra_high = np.zeros((2, 0)) if limits is None else limits.extra_limits
    column_scale = np.concatenate([part.unit, np.ones(excess), np.full(ne, length)])
    quadratic = np.diag(
        np.concatenate([np.ones(nf), np.full(excess, edge_cost), np.full(ne, EXTRA_COST)])
        / column_scale**2
    )
    linear = np.zeros(nx)
    for cost in costs:
        cost.check_size(nf)
        quadratic[:nf, :nf] += cost.p
        linear[:nf] += cost.q
    asked = max([*np.abs(balance[:3]), *(np.abs(balance[3:]) / length), *least])
    return ForceProblem(
        contacts=contacts,
        wrench=balance,
        quadratic=quadratic,
        linear=linear,
        rows=rows,
        low=low,
        high=high,
        row_names=(
            *_WRENCH_ROWS,
            *part.face_names,
            *("passive force by compliance",) * mp,
            *(() if limits is None else _torque_names(limits, tuple(torque_rows.tolist()))),
        ),
        n_faces=mf,
        torque_rows=torque_rows,
        cones=np.concatenate([part.cones, np.zeros((len(part.cones), ne))], axis=1),
        cone_sizes=part.cone_sizes,
        cone_names=part.cone_names,
        lower=np.concatenate([lower, np.zeros(excess), extra_low]),
        upper=np.concatenate([upper, np.full(excess, np.inf), extra_high]),
        column_names=(
            *part.names,
            *part.excess_names,
            *(() if limits is None else _made_names(limits, limits.case.extra.tolist())),
        ),
        column_scale=column_scale,
        row_scale=np.concatenate(
            [np.ones(3), np.full(3, 1 / length), np.ones(mf + mp), np.full(mt, 1 / length)]
        ),
        length=length,
        force_scale=asked if asked > MIN_SCALE else 1.0,
        cost_names=(
            "contact forces",
            *["edge of the cones"][: excess and 1],
            *(c.name for c in costs),
        ),
        joint_map=joint_map,
        gravity_torque=gravity,
        torque_limits=limits,
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
    gravity = (
        np.zeros(nv)
        if gravity_torque is None
        else finite_array("gravity_torque", gravity_torque, (nv,))
    )
    if n and dims == (3,) * n:
        turned = contacts.frames.transpose(0, 2, 1) @ jac[:, :3]
        return np.ascontiguousarray(turned.reshape(-1, nv).T), gravity
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
    return np.hstack(columns), gravity


def _torque_limits(
    actuation: Actuation | None,
    joint_map: FloatArray,
    q: ArrayLike | None,
    gravity: FloatArray,
    with_jacobians: bool,
) -> TorqueLimits | None:
    """The limits in N m, None without an actuation.

    Raises:
        ContactError: ``actuation`` without ``q`` or Jacobians, q without ``actuation``, or their
            sizes differ.
    """
    if actuation is None:
        if q is not None:
            raise ContactError("q is given without an actuation; give both or neither")
        return None
    if q is None or not with_jacobians:
        raise ContactError("actuation limits need q (nv,) and jacobians (n, 3 or 6, nv)")
    nv = len(actuation.joint_names)
    at = np.array(q, dtype=np.float64)
    if len(joint_map) != nv or at.shape != (nv,) or not np.isfinite(at).all():
        raise ContactError(
            f"q has shape {at.shape} and the jacobians {len(joint_map)} joints; the actuation "
            f"has {nv} joints: give finite numbers for these, in its order"
        )
    limits = TorqueLimits(actuation, 1.0)
    limits.gravity[:] = gravity
    return limits


def _made_names(limits: TorqueLimits, columns: Sequence[int]) -> list[str]:
    """Names of actuators and stops by their column."""
    names = (*limits.actuation.names, *limits.actuation.stop_names)
    return [names[j] for j in columns]


def _torque_names(limits: TorqueLimits, rows: tuple[int, ...]) -> tuple[str, ...]:
    """What each row of torque is: an actuator, a stop, or joints that nothing drives that way."""
    return _names_of_case(limits.actuation, limits.case, rows)


@made_once(256)
def _names_of_case(
    actuation: Actuation, case: TorqueCase, rows: tuple[int, ...]
) -> tuple[str, ...]:
    names, out = (*actuation.names, *actuation.stop_names), list[str]()
    for i in rows:
        column = case.made[i]
        if column >= 0:
            out.append(names[column])
        else:
            mixed = (actuation.joint_names[j] for j in np.flatnonzero(case.rows[i]))
            out.append(f"undriven torque of {', '.join(mixed)}")
    return tuple(out)
