"""``ObjectLag``: how far the object is from where the plan has it, told in joints.

It is the sense ``object`` of a policy (``sim.learning.senses``). The pose is that of an estimator;
without a camera it is made of joints and touch (``sim.estimation``). With G the planned map from
joint rates to the object's twist (contacts stick, least squares over the contacts), a deviation e
of the pose is told as

    G_t' e_t / l^2,   G_r' e_r / l^2,      e_r and G_r times l, in degrees:

the pattern of joint torques that pushes the object back, for shift and turn apart. So one small
network serves plans with other contacts and other fingers.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from scipy.interpolate import CubicSpline

from planner.kinematics.state import HandState
from planner.motion import Knot, MotionPlan
from planner.plan import GraspPlan
from planner.spatial import SE3, FloatArray, skew
from sim.controllers import Observation

PLACES = 101
"""Places on the path at which everything planned is tabulated: a degree apart."""

LENGTH = 0.03
"""Length l (m) that makes a turn a shift: about the radius of what a hand turns."""

FIRM = 1e-4
"""Regularisation of G (-): contacts on one line do not see the turn about it."""


class ObjectLag:
    """The deviation of the object along one plan."""

    def __init__(self, plan: GraspPlan) -> None:
        """Prepare for a grasp; ``follow`` for a motion.

        Args:
            plan: The grasp.
        """
        self._plan = plan
        T_base_object = plan.T_world_base.inverse() * plan.task.T_world_object
        self._first: FloatArray = T_base_object.rotation
        row = np.concatenate(
            [np.zeros(3), T_base_object.translation, _map(plan, plan.q, plan, T_base_object)]
        )
        self._table: FloatArray = row[None]
        self._axis = np.zeros(3)
        self._begin: FloatArray | None = None

    def follow(self, motion: MotionPlan) -> None:
        """Go along a motion; the deviation counts from the next one that is read."""
        T_base_world = motion.T_world_base.inverse()
        poses = [T_base_world * k.T_world_object for k in motion.knots]
        self._first = poses[0].rotation
        rows = [
            np.concatenate(
                [
                    pin.log3(pose.rotation @ self._first.T),
                    pose.translation,
                    _map(self._plan, knot.q, knot, pose),
                ]
            )
            for pose, knot in zip(poses, motion.knots, strict=True)
        ]
        spline = CubicSpline([k.path_parameter for k in motion.knots], np.array(rows))
        self._table = np.asarray(spline(np.linspace(0.0, 1.0, PLACES)))
        self._axis = T_base_world.rotation @ motion.path.axis
        self._begin = None

    def told(self, observation: Observation, place: float) -> FloatArray:
        """What is told at a place of the path, 0 to 1: (2 nq,), degrees.

        What the deviation was at first is kept about the axis and fades out in the other
        directions, as the reference of a turn has it (``sim.controllers.follow``).
        """
        row = interpolated(self._table, place)
        pose = observation.T_world_base.actInv(observation.T_world_object)
        planned = pin.exp3(row[:3]) @ self._first
        deviation = np.concatenate(
            [pose.translation - row[3:6], LENGTH * pin.log3(pose.rotation @ planned.T)]
        )
        if self._begin is None:
            self._begin = deviation
        kept = (1.0 - place) * self._begin
        kept[3:] += place * (self._axis @ self._begin[3:]) * self._axis
        error = (deviation - kept) / LENGTH**2
        by_joints = row[6:].reshape(6, -1)
        told = np.concatenate([error[:3] @ by_joints[:3], error[3:] @ by_joints[3:]])
        return np.asarray(np.rad2deg(told))


def interpolated(table: FloatArray, place: float) -> FloatArray:
    """The row of a table (places, m) at a place of the path, 0 to 1."""
    last = len(table) - 1
    at = place * last
    k = min(int(at), max(0, last - 1))
    row = table[k] if last == 0 else table[k] + (at - k) * (table[k + 1] - table[k])
    return np.asarray(row)


def _map(plan: GraspPlan, q: FloatArray, knot: Knot | GraspPlan, pose: SE3) -> FloatArray:
    """Twist of the object (turns times ``LENGTH``) per joint rate, (6 nq,), base axes."""
    state = HandState(plan.task.hand, q)
    contacts = knot.contacts.transformed(plan.T_world_base.inverse())
    at, moves = [], []
    for finger, point in zip(plan.task.fingers, contacts.positions, strict=True):
        at.append(np.hstack([np.eye(3), -skew(point - pose.translation) / LENGTH]))
        moves.append(state.point_jacobian(finger.pad.joint_id, point)[:3])
    A, J = np.vstack(at), np.vstack(moves)
    return np.asarray(np.linalg.solve(A.T @ A + FIRM * np.eye(6), A.T @ J)).ravel()
