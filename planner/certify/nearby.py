"""The most that any grasp near a planned one can bear along a direction: a bound, by duality.

A disturbance t w is balanced by contact forces f_i, with torsions s_i, and by actuator forces F and
reactions lam of stops, where

    G f + W + t w = 0,        J^T f + g = R^T F + S^T lam + p.

Take any motion u = (v, omega) of the object with w . u = 1 and any joint velocities mu (here x =
(u, mu)) that leave no active stop, S mu >= 0. Multiply the first line by u and the second by mu:

    t = -W . u + sum_i (f_i . d_i + s_i e_i) - (R mu) . F - (S mu) . lam + mu . (g - p),
    d_i = J_i mu - (v + omega x r_i),    e_i = n_i . (A_i mu - omega).

Where no contact force can do work on its d_i and e_i, which is the dual friction cone,

    phi_i = n_i . d_i + |(mu_f d_t, mu_t e)| <= 0,

t is at most -W . u + max over F of -(R mu) . F + mu . (g - p). That holds for one posture. In a
neighbourhood, d_i and e_i differ by what ``Changes`` bounds, and phi_i by at most

    sqrt(1 + mu_f^2) (2 sin(a / 2) (|d_i| + r) + r) + mu_t (2 sin(a / 2) (|g_i| + z) + z),

with the tilt a of the normal, r = |omega| (change of the arm) + sum_j |mu_j| (change of J_ij), and
z the same of A. Where phi_i plus that is not positive for any contact, the bound holds for all
members. All of it is convex and homogeneous in x: the least bound is sought with cutting planes,
and what was found is evaluated by the formulas above, which are the proof. Dry friction of joints,
which a simulation has and a certificate has not, is allowed the hand as well.

Grasps near a planned one: how far contacts, normals, Jacobians and limits can be from its own.

A hand that is pushed yields, and an object that is pushed turns under the pads: what holds the load
in the end is not the planned posture but one near it. A ``Neighbourhood`` says how near. Its
members are all grasps with

object  its centre of mass within ``shift`` of the planned place and turned by at most ``turn``,
        seen from the hand's base;
pads    their centres within ``tips`` of the planned places, in the base;
joints  every one within ``joints`` of the plan's;
contact of each pad where the surface is nearest to its centre, as in
        ``planner.certify.tolerance``: the pad, a ball, touches it there.

``Changes`` bounds what differs between the plan and any member. Distances along a path in which all
joints move at once bound the Jacobians: the column of joint j at a point p, a x (p - o), turns with
the joints before j, and p - o changes with the contact and with the origin o; or p moves with the
link, by the joints from j on and by rolling on the pad. The less of both is taken.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike

from planner.arrays import check_fields
from planner.certify.tolerance import PoseErrors, largest_turn
from planner.contacts import ContactSet
from planner.errors import ContactError, shown
from planner.joints.actuation import STOP_TOL
from planner.kinematics import HandState, joint_axes
from planner.numerics.lp import LpSolution, solve_lp
from planner.plan import GraspPlan
from planner.spatial import FloatArray, IntArray, skew


@dataclass(frozen=True, kw_only=True)
class Neighbourhood:
    """How far a grasp may be from the planned one; see the module.

    Attributes:
        shift: Of the object, m.
        turn: Of the object, rad.
        tips: Of the pads' centres, m.
        joints: Of every joint, rad (slides: ``tips``).
    """

    shift: float = 1e-3
    turn: float = float(np.deg2rad(1.0))
    tips: float = 1e-3
    joints: float = float(np.deg2rad(1.0))

    def __post_init__(self) -> None:
        """Check every number.

        Raises:
            TaskError: One is negative or not finite.
        """
        check_fields(self, what="neighbourhood: ", least=0.0, unit="m or rad")

    def holds(self, other: Neighbourhood) -> bool:
        """Whether another one lies within this."""
        return all(getattr(other, f.name) <= getattr(self, f.name) for f in fields(self))

    def __str__(self) -> str:
        """The sizes in mm and degrees."""
        turn, joints = np.rad2deg([self.turn, self.joints])
        return (
            f"object within {1e3 * self.shift:g} mm and {turn:g} degrees, "
            f"fingertips within {1e3 * self.tips:g} mm, joints within {joints:g} degrees"
        )


NEAR = Neighbourhood()
"""Neighbourhood for which bounds are given beside the planned posture, unless another is named."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Changes:
    """Bounds of what differs between a plan and any member of a neighbourhood.

    Attributes:
        arms: (n,), of the contacts' positions about the centre of mass, m.
        tilts: (n,), of their normals, rad; pi / 2 where nothing is known.
        jacobians: (n, 2, nq), of the velocities, linear and angular, of each contact per joint
            velocity.
        limits: (nu, 2), least and greatest force of each actuator anywhere, N m.
        stops: Indices of the stops that are active somewhere.
        torques: (nq,), of what gravity and springs make at each joint, N m.
        reason: Why nothing is known of the contacts; "" where it is.
    """

    arms: FloatArray
    tilts: FloatArray
    jacobians: FloatArray
    limits: FloatArray
    stops: IntArray
    torques: FloatArray
    reason: str

    @classmethod
    def of(cls, plan: GraspPlan, near: Neighbourhood) -> Changes:
        """The bounds for a plan."""
        task = plan.task
        radii = np.array([finger.pad.radius for finger in task.fingers])
        poses = PoseErrors.of(task.object.shape, plan.contacts_in_object, radii)
        chord = 2.0 * np.sin(min(near.turn, np.pi) / 2.0)
        moved = near.tips + near.shift + chord * np.linalg.norm(poses.centers, axis=1)
        turned = largest_turn(
            task.object.shape, poses.contacts.positions, -poses.contacts.normals, radii, moved
        )
        tilts = np.where(turned < np.pi / 2, np.minimum(turned + near.turn, np.pi / 2), np.pi / 2)
        # a contact is a pad's radius off its centre along the normal
        placed = near.tips + radii * 2.0 * np.sin(tilts / 2.0)
        arms = np.minimum(
            moved + chord * np.linalg.norm(poses.contacts.positions, axis=1), placed + near.shift
        )
        ways = np.minimum(near.shift + arms, placed)
        tree = _Tree(plan, near)
        points = plan.contacts.transformed(plan.T_world_base.inverse()).positions
        jacobians = np.array(
            [
                tree.jacobian(f.pad.joint_id, p, moved=way, rolling=rho, tilt=tilt)
                for f, p, way, rho, tilt in zip(
                    task.fingers, points, ways, radii, tilts, strict=True
                )
            ]
        )
        actuation = task.hand.actuation
        slack = np.abs(actuation.stop_rows) @ tree.bent
        gaps = actuation.stop_rows @ plan.q - actuation.stop_values
        springs = np.abs(actuation.stiffness) @ tree.bent
        return cls(
            arms=arms,
            tilts=tilts,
            jacobians=jacobians,
            limits=_limits(plan, tree.bent),
            stops=np.flatnonzero(gaps <= STOP_TOL + slack),
            torques=springs + tree.gravity(float(np.linalg.norm(task.gravity))),
            reason=poses.reason,
        )


class _Tree:
    """The hand's joints at the plan: who moves whom, and lengths along the links.

    Attributes:
        bent: (nq,), how far each joint may be from the plan's, rad or m.
    """

    def __init__(self, plan: GraspPlan, near: Neighbourhood) -> None:
        self._hand = plan.task.hand
        model = self._hand.pin_model
        state = HandState(self._hand, plan.q)
        self._state = state
        self._id = np.array(  # Pinocchio's joint of each q
            sorted(range(1, model.njoints), key=lambda j: model.joints[j].idx_v), dtype=np.int64
        )
        self._origins = np.array([state.joint_pose(j).translation for j in self._id.tolist()])
        self._hinge = np.asarray(joint_axes(model)[self._id, 3:].any(axis=1))
        self.bent = np.where(self._hinge, near.joints, near.tips)
        # [j, k]: whether joint k moves joint j, itself among them
        self._moves = np.asarray(self._hand.moved_by[self._id], dtype=bool)
        self._before = self._moves & ~np.eye(len(self._id), dtype=bool)
        parents = [int(model.parents[j]) for j in self._id.tolist()]
        self._steps = np.array(
            [
                np.linalg.norm(o - state.joint_pose(p).translation) if p else 0.0
                for o, p in zip(self._origins, parents, strict=True)
            ]
        ) + np.where(self._hinge, 0.0, self.bent)
        self._turns = self._before @ np.where(self._hinge, self.bent, 0.0)
        self._strayed = np.array([self._stray(j) for j in range(len(self._id))])

    def jacobian(
        self, joint_id: int, point: FloatArray, *, moved: float, rolling: float, tilt: float
    ) -> FloatArray:
        """Bounds (2, nq), linear and angular, for a contact.

        Args:
            joint_id: Pinocchio joint of the pad.
            point: (3,), planned contact in the base, m.
            moved: Bound of the contact's way in the base, m.
            rolling: Radius of the pad, m.
            tilt: Bound of the turn of the contact's normal in the base, rad.
        """
        mine = np.asarray(self._hand.moved_by[joint_id], dtype=bool)
        turns = np.where(self._hinge, self.bent, 0.0)
        reach = np.linalg.norm(point - self._origins, axis=1)
        on_pad = rolling * (tilt + float(turns[mine].sum()))
        # by place: the axis turns, point and origin move
        axes = np.minimum(self._turns, 2.0)
        by_place = axes * reach + moved + self._strayed
        # by link: the column turns with what comes first, and grows by what comes later
        later = np.zeros(len(self._id))
        for j in sorted(np.flatnonzero(mine), key=lambda j: -int(self._moves[j].sum())):
            after = mine & ~self._moves[j]
            far = np.where(self._hinge, reach + on_pad + later, 1.0)
            later[j] = self.bent[after] @ far[after]
        columns = np.linalg.norm(self._state.point_jacobian(joint_id, point)[:3], axis=0)
        by_link = (self._turns + turns) * (columns + later + on_pad) + later + on_pad
        linear = np.where(self._hinge, np.minimum(by_place, by_link), axes)
        angular = np.where(self._hinge, axes, 0.0)
        return np.where(mine, np.array([linear, angular]), 0.0)

    def gravity(self, size: float) -> FloatArray:
        """Bounds (nq,), N m, of the change of the torques that hold the hand; gravity in m/s2.

        The derivative of the torque at one joint by another is at most the moment, about the later
        one of the two, of all mass that it moves; for slides, that mass.
        """
        model = self._hand.pin_model
        moment = np.zeros(len(self._id))
        for j in range(1, model.njoints):
            body = model.inertias[j]
            carried = np.asarray(self._hand.moved_by[j], dtype=bool)
            lever = float(np.linalg.norm(body.lever))
            for k in np.flatnonzero(carried).tolist():
                between = carried & self._before[:, k]
                arm = lever + self._steps[between].sum() if self._hinge[k] else 1.0
                moment[k] += body.mass * arm
        pairs = np.where(self._moves, moment[:, None], 0.0)
        pairs = np.maximum(pairs, pairs.T)
        return np.asarray(size * pairs @ self.bent)

    def _stray(self, j: int) -> float:
        """Bound of the way of joint j's origin, m: the joints before it turn the links between."""
        total = 0.0
        for k in np.flatnonzero(self._before[j]).tolist():
            between = self._moves[j] & self._before[:, k]
            total += self.bent[k] * (self._steps[between].sum() if self._hinge[k] else 1.0)
        return total


def _limits(plan: GraspPlan, bent: FloatArray) -> FloatArray:
    """Least and greatest force (nu, 2) of each actuator: at the ends of its length, N m.

    A force range and a law that is affine in the length, clipped, are monotone in it.
    """
    actuation = plan.task.hand.actuation
    out = np.empty((len(actuation.names), 2))
    for i, row in enumerate(actuation.moment):
        ends = [actuation.force_limits(plan.q + s * np.sign(row) * bent)[i] for s in (-1.0, 1.0)]
        out[i] = np.min(ends, axis=0)[0], np.max(ends, axis=0)[1]
    return out


SIDES = 16
"""Cuts per contact to begin with (-)."""

CUTS = 80
"""Most rounds of cutting planes (-)."""

TIGHT = 1e-5
"""By how much (-) cuts are tighter than they must be, in units of the object's velocity: what is
left of a violation when the rounds end."""

FASTEST = 1e4
"""Largest unknown (-) in units of the velocity of the object: more is no bound of use."""

SOLVER_MARGIN = 1e-7
"""Share of a bound (-) that is added to it for the tolerance of ``solve_lp``."""


@dataclass(frozen=True, kw_only=True)
class NearBound:
    """What no grasp in a neighbourhood can bear more of.

    Attributes:
        factor: Largest multiple of the direction, proven; infinite where none was found (-).
        near: The neighbourhood.
        reason: Why there is no bound; "" where there is.
    """

    factor: float
    near: Neighbourhood
    reason: str = ""


LINKS_MOVE = "links and palm touch, whose contacts move along them by more than a pad rolls"
"""Why nothing is bounded near a grasp of the whole hand."""


def bound_nearby(
    plan: GraspPlan,
    direction: ArrayLike,
    *,
    contacts: ContactSet | None = None,
    near: Neighbourhood = NEAR,
) -> NearBound:
    """The largest multiple of a wrench that any grasp near a plan can bear on top of the weight.

    Args:
        plan: The grasp.
        direction: (6,), N and N m, world axes about the centre of mass.
        contacts: The plan's contacts with another friction; its own if None.
        near: How near.

    Raises:
        ContactError: The direction is not six finite numbers, or is zero.
    """
    along = np.asarray(direction, dtype=np.float64)
    if along.shape != (6,) or not np.isfinite(along).all() or not along.any():
        raise ContactError(
            f"direction is {shown(direction)}; give six finite numbers, not all zero"
        )
    if not plan.task.is_of_fingertips:
        return NearBound(factor=np.inf, near=near, reason=LINKS_MOVE)
    changes = Changes.of(plan, near)
    if changes.reason and (near.shift or near.turn or near.tips):
        return NearBound(factor=np.inf, near=near, reason=changes.reason)
    search = _Search(plan, along, plan.contacts if contacts is None else contacts, changes)
    return NearBound(factor=search.run(), near=near, reason=search.reason)


class _Search:
    """The programme over x = (v, omega, joint velocities), |joint velocities|, and R mu split."""

    def __init__(
        self, plan: GraspPlan, along: FloatArray, contacts: ContactSet, changes: Changes
    ) -> None:
        """Maps from x to d_i and A_i mu - omega, base costs, and the first cuts."""
        task = plan.task
        hand, actuation = task.hand, task.hand.actuation
        problem = plan.forces.problem  # its weight and the hand's; friction comes with the contacts
        self.reason = ""
        self._length = problem.length
        nv = self._nv = len(actuation.joint_names)
        nu = self._nu = len(actuation.names)
        state, inverse = HandState(hand, plan.q), plan.T_world_base.inverse()
        turn = plan.T_world_base.rotation
        self._changes, self._contacts = changes, contacts
        self._mu, self._twist = contacts.friction.T
        self._linear, self._angular = np.zeros((2, len(contacts), 3, 6 + nv))
        for i, (finger, point) in enumerate(zip(task.fingers, contacts.positions, strict=True)):
            jac = turn @ state.point_jacobian(finger.pad.joint_id, inverse.act(point)).reshape(
                2, 3, nv
            )
            arm = point - contacts.center
            self._linear[i] = np.hstack([-np.eye(3), skew(arm), jac[0]])
            self._angular[i] = np.hstack([np.zeros((3, 3)), -np.eye(3), jac[1]])
        friction = np.array(hand.pin_model.upperDryFrictionLimit)
        gravity = problem.gravity_torque - actuation.passive_torque(plan.q)
        low, high = changes.limits.T
        self._cost = np.concatenate(
            [
                -problem.wrench,
                gravity,
                changes.torques + friction,
                -np.where(np.isfinite(low), low, 0.0),
                np.where(np.isfinite(high), high, 0.0),
            ]
        )
        self._bounds = np.vstack(
            [
                np.tile([-1.0, 1.0], (6 + nv, 1)) * FASTEST,
                np.tile([0.0, FASTEST], (nv, 1)),
                np.column_stack([np.zeros(nu), np.where(np.isfinite(low), FASTEST, 0.0)]),
                np.column_stack([np.zeros(nu), np.where(np.isfinite(high), FASTEST, 0.0)]),
            ]
        )
        # unknowns by velocity of the object: angular ones and those of joints by the length
        self._unit = np.concatenate(
            [np.ones(3), np.full(3 + 2 * nv, 1 / self._length), np.full(2 * nu, 1 / self._length)]
        )
        self._along = along * np.repeat([1.0, 1 / self._length], 3)
        self._size = float(np.linalg.norm(self._along))
        self._rows, self._limits = self._fixed(actuation.moment, actuation.stop_rows)
        self._cuts = [self._gradient(i, s) for i in range(len(contacts)) for s in self._first(i)]

    def run(self) -> float:
        """The least bound found, at least 0; infinite where there is none."""
        for _ in range(CUTS):
            found = self._solve()
            if found is None:
                break
            x = found.x * self._unit
            rows = [self._gradient(i, x) for i in range(len(self._contacts))]
            worst = [float(row @ x) for row in rows]  # phi_i and all that it may grow by
            if max(worst) <= 0.0:
                return max(0.0, found.value * (1.0 + SOLVER_MARGIN) / self._size)
            self._cuts += [row for row, excess in zip(rows, worst, strict=True) if excess > 0.0]
        self.reason = "no motion of the object was found that all contacts of all members hinder"
        return np.inf

    def _solve(self) -> LpSolution | None:
        """Unknowns of the least bound under the present cuts; None where none are known."""
        rows = np.vstack([self._rows, *self._cuts])
        limits = np.vstack([self._limits, np.tile([-np.inf, -TIGHT], (len(self._cuts), 1))])
        found = solve_lp(self._cost * self._unit, rows * self._unit, limits, self._bounds)
        return found if isinstance(found, LpSolution) else None

    def _fixed(self, moment: FloatArray, stops: FloatArray) -> tuple[FloatArray, FloatArray]:
        """W . u = 1; |mu|; R mu in two parts; stops that may be active are not left."""
        nv, nu, width = self._nv, self._nu, len(self._cost)
        one = np.zeros((1, width))
        one[0, :6] = self._along * np.repeat([1.0, self._length], 3) / self._size
        absolute = np.zeros((2 * nv, width))
        absolute[:nv, 6 : 6 + nv], absolute[nv:, 6 : 6 + nv] = -np.eye(nv), np.eye(nv)
        absolute[:, 6 + nv : 6 + 2 * nv] = np.vstack([np.eye(nv)] * 2)
        parts = np.zeros((nu, width))
        parts[:, 6 : 6 + nv] = moment
        parts[:, 6 + 2 * nv :] = np.hstack([-np.eye(nu), np.eye(nu)])
        held = np.zeros((len(self._changes.stops), width))
        held[:, 6 : 6 + nv] = stops[self._changes.stops]
        limits = np.vstack(
            [
                [[1.0, 1.0]],
                np.tile([0.0, np.inf], (2 * nv, 1)),
                np.zeros((nu, 2)),
                np.tile([0.0, np.inf], (len(held), 1)),
            ]
        )
        return np.vstack([one, absolute, parts, held]), limits

    def _gradient(self, i: int, x: FloatArray) -> FloatArray:
        """Gradient (width,) at x of the constraint of contact i: its tangent half-space.

        The constraint is homogeneous: its value at x is this times x.
        """
        n_x, changes = 6 + self._nv, self._changes
        linear, angular = self._linear[i], self._angular[i]
        normal, mu, twist = self._contacts.normals[i], self._mu[i], self._twist[i]
        d, g = linear @ x[:n_x], angular @ x[:n_x]
        side = mu * (d - (normal @ d) * normal)
        spin = twist * (normal @ g)
        total = np.sqrt(side @ side + spin * spin)
        out = np.zeros(len(x))
        out[:n_x] = normal @ linear
        if total > 0.0:
            out[:n_x] += (mu * side @ linear + twist * spin * (normal @ angular)) / total
        chord = 2.0 * np.sin(changes.tilts[i] / 2.0)
        steep = np.sqrt(1.0 + mu * mu)
        out[:n_x] += steep * chord * (_unit(d) @ linear) + twist * chord * (_unit(g) @ angular)
        out[3:6] += steep * (1.0 + chord) * changes.arms[i] * _unit(x[3:6])
        places, turns = changes.jacobians[i]
        out[n_x : n_x + self._nv] += (1.0 + chord) * (steep * places + twist * turns)
        return out

    def _first(self, i: int) -> FloatArray:
        """Unknowns (``SIDES``, width) at which the first cuts of a contact touch: it slides."""
        frame, angle = self._contacts.frames[i], 2 * np.pi * np.arange(SIDES) / SIDES
        ways = np.cos(angle)[:, None] * frame[:, 1] + np.sin(angle)[:, None] * frame[:, 2]
        out = np.zeros((SIDES, len(self._cost)))
        out[:, :3] = -ways
        return out


def _unit(vector: FloatArray) -> FloatArray:
    size = np.linalg.norm(vector)
    return vector / size if size > 0.0 else np.zeros_like(vector)
