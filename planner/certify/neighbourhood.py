"""Grasps near a planned one: how far contacts, normals, Jacobians and limits can be from its own.

A hand that is pushed yields, and an object that is pushed turns under the pads: what holds the load
in the end is not the planned posture but one near it. A ``Neighbourhood`` says how near. Its
members are all grasps with

object  its centre of mass within ``shift`` of the planned place and turned by at most ``turn``,
        seen from the hand's base;
pads    their centres within ``tips`` of the planned places, in the base;
joints  every one within ``joints`` of the plan's;
contact of each pad where the surface is nearest to its centre, as in ``planner.certify.pose``: the
        pad, a ball, touches it there.

``Changes`` bounds what differs between the plan and any member. Distances along a path in which all
joints move at once bound the Jacobians: the column of joint j at a point p, a x (p - o), turns with
the joints before j, and p - o changes with the contact and with the origin o; or p moves with the
link, by the joints from j on and by rolling on the pad. The less of both is taken.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from planner.arrays import check_fields
from planner.certify.pose import PoseErrors, largest_turn
from planner.joints.actuation import STOP_TOL
from planner.kinematics.state import HandState, joint_axes
from planner.plan import GraspPlan
from planner.spatial import FloatArray, IntArray


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
