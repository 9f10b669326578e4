"""``Playback``: the turn of a plan by the clock, as commands: nothing is measured of the object.

It is what a policy corrects (``sim.learning.controller``), and by itself the open loop that a
policy is compared with. Posture and planned forces are those of the plan's knots:

    ctrl(s, g) = rest(s) + g (full(s) - rest(s)) + K (q0 - q(0))

with s the place on the path, ``rest`` the commands that hold the planned posture against gravity,
``full`` those that exert the planned forces too, and g the share of the forces, which ramps up in
the squeeze and down in the release. The fingers close until they touch, wherever that is: q0 is the
posture as read at that moment, and K takes the servos along.

``ObjectLag``: how far the object is from where the plan has it, told in joints.

It is the sense ``object`` of a policy (``sim.learning.senses``). The pose is that of an estimator;
without a camera it is made of joints and touch (``sim.estimation``). With G the planned map from
joint rates to the object's twist (contacts stick, least squares over the contacts), a deviation e
of the pose is told as

    G_t' e_t / l^2,   G_r' e_r / l^2,      e_r and G_r times l, in degrees:

the pattern of joint torques that pushes the object back, for shift and turn apart. So one small
network serves plans with other contacts and other fingers.
"""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
from scipy.interpolate import CubicSpline

from planner.errors import HandError
from planner.hands.hand import Hand
from planner.kinematics.state import HandState
from planner.motion import Knot, MotionPlan
from planner.plan import GraspPlan
from planner.spatial import SE3, FloatArray, minimum_jerk, skew
from sim.controllers import MotionReference, Observation, Phase
from sim.controllers.follow import CREEP, RAMP, RATE
from sim.controllers.grasp import FIRST_SHARE
from sim.controllers.loads import HandLoads, crossed

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


AIM = float(np.deg2rad(2.0))
"""Turn (rad) beyond the goal at which the clock ends. With the half degree by which every goal lies
beyond the asked turn (``sim.manipulation.driver.BEYOND``) that is the middle of what the protocol
accepts, up to 5 degrees more. Without a camera nothing tells the last degree."""

STANDING: frozenset[Phase] = frozenset({"squeeze", "settle", "lower", "release"})
"""Phases in which the table carries the object, or may."""


class Playback:
    """One plan by the clock; ``step`` once a time step, from the squeeze on.

    Attributes:
        plan: The grasp.
        aim: Turn beyond the asked one at which it ends, rad.
        shift: K (nu, nq): change of a servo's command per change of its joint's reading.
        place: Where on the path it is, 0 to 1.
        rate: Rate of the turn now, rad/s.
        share: Share of the planned forces now, 0 to 1.
        q: Planned posture (nq,) of now, rad, as it would be read.
        ctrl: Commands (nu,) of now.
        press: (nu,), the part of them that exerts the planned forces.
        bent: (nq,), posture as read at the first touch less the planned one, rad.
        standing: Whether the object stands on something, by the phase.
        lag: How far the object is from where it should be by now.
    """

    def __init__(self, plan: GraspPlan, *, aim: float = AIM) -> None:
        """Prepare for a plan; a motion is followed once there is a ``reference``.

        Args:
            plan: The grasp.
            aim: Turn beyond the asked one at which it ends, rad.

        Raises:
            HandError: An actuator of the hand is no position servo.
        """
        self.plan, self.aim = plan, aim
        self.shift = servo_shift(plan.task.hand)
        self._reference: MotionReference | None = None
        self._table = _tabulated(plan, None)
        self.lag = ObjectLag(plan)
        self._gone, self._end, self._whole = 0.0, 0.0, 1.0
        self._time: float | None = None
        self.rate, self.share, self.standing = 0.0, 0.0, True
        self.bent = np.zeros(plan.task.hand.nq)
        self._turn_to(0.0)

    @property
    def reference(self) -> MotionReference | None:
        """What tells the phases of a manipulation how far the turn has come: told by the clock."""
        return self._reference

    @reference.setter
    def reference(self, reference: MotionReference | None) -> None:
        self._reference = reference
        if reference is None:
            return
        motion = reference.motion
        self._table = _tabulated(self.plan, motion)
        self.lag.follow(motion)
        self._whole = abs(motion.path.angle)
        self._end = min(abs(reference.goal) + self.aim, self._whole)
        self._gone, self.rate = 0.0, 0.0
        self._turn_to(0.0)

    @property
    def end(self) -> float:
        """Turn (rad, with its sign) at which the clock ends."""
        goal = 0.0 if self._reference is None else self._reference.goal
        return math.copysign(self._end, goal)

    @property
    def place(self) -> float:
        """Where on the path it is, 0 to 1."""
        return min(1.0, self._gone / self._whole)

    @property
    def T_palm_object(self) -> SE3 | None:
        """Where the plan has the object now, in the palm; None without a motion."""
        if self._reference is None:
            return None
        pose, _ = self._reference.motion.at(self.place)
        return self.plan.T_world_palm.inverse() * pose

    def step(self, observation: Observation) -> None:
        """Go on to now; the first call takes over the posture in which the fingers touch."""
        now, phase = observation.time, observation.phase
        elapsed = 0.0 if self._time is None else now - self._time
        if self._time is None:
            self.bent = observation.q - self._table[0, : len(observation.q)]
        self._time = now
        ramp = 1.0
        if phase in ("squeeze", "release"):
            ramp = observation.progress if phase == "squeeze" else 1.0 - observation.progress
        self.share = FIRST_SHARE + (1.0 - FIRST_SHARE) * float(minimum_jerk(np.asarray(ramp)))
        self.standing = phase in STANDING
        if phase in ("turn", "hold") and self._reference is not None:
            self._advance(elapsed)
        self._turn_to(self.place)

    def _advance(self, elapsed: float) -> None:
        """The law of ``MotionReference``, with an object that follows."""
        left = max(0.0, self._end - self._gone)
        acceleration = RATE / RAMP
        rate = min(
            RATE,
            self.rate + acceleration * elapsed,
            math.sqrt(2.0 * acceleration * left) + CREEP * RATE,
        )
        if elapsed > 0.0:
            self.rate = min(rate, left / elapsed)
        self._gone += self.rate * elapsed

    def _turn_to(self, place: float) -> None:
        """Take posture and commands from the table."""
        row = interpolated(self._table, place)
        nq, nu = len(self.bent), len(self.shift)
        self.q = row[:nq] + self.bent
        self.press = row[nq + nu :]
        self.ctrl = row[nq : nq + nu] + self.share * self.press + self.shift @ self.bent


def servo_shift(hand: Hand) -> FloatArray:
    """Change (nu, nq) of a servo's command per change of its joint's reading.

    Raises:
        HandError: An actuator of the hand is no position servo.
    """
    actuation = hand.actuation
    servo = -actuation.bias[:, 1] / actuation.gain
    motors = [name for name, k in zip(actuation.names, servo, strict=True) if k <= 0.0]
    if motors:
        raise HandError(
            f"{', '.join(motors)} of {hand.name} are no position servos, and a policy commands "
            "joint targets; give a hand whose actuators are servos"
        )
    return np.asarray(servo[:, None] * actuation.moment)


def _tabulated(plan: GraspPlan, motion: MotionPlan | None) -> FloatArray:
    """Posture, commands at rest, and what pressing adds, (places, nq + 2 nu), along the path."""
    task = plan.task
    loads, actuation = HandLoads(task.hand, task.fingers), task.hand.actuation
    T_base_world = plan.T_world_base.inverse()
    gravity, still = T_base_world.rotation @ task.gravity, np.zeros(task.hand.nq)
    knots = [(0.0, plan.q, plan.contacts)]
    if motion is not None:
        knots = [(k.path_parameter, k.q, k.contacts) for k in motion.knots]
    rows = []
    for _, q, contacts in knots:
        in_base = contacts.transformed(T_base_world)
        weight = loads.move(q, gravity)
        forces = in_base.forces_in_axes()
        pressing = loads.torque(forces, crossed(in_base.positions, forces))
        rest = actuation.commands(q, still, weight)
        rows.append(
            np.concatenate([q, rest, actuation.commands(q, still, weight + pressing) - rest])
        )
    if len(rows) == 1:
        return np.array(rows)
    spline = CubicSpline([place for place, _, _ in knots], np.array(rows))
    return np.asarray(spline(np.linspace(0.0, 1.0, PLACES)))
