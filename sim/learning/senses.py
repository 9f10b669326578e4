"""``Playback``: the turn of a plan by the clock, as commands: nothing is measured of the object.

It is what a policy corrects (``sim.learning.controller``), and by itself the open loop that a
policy is compared with. Posture and planned forces are those of the plan's knots:

    ctrl(s, g) = rest(s) + g (full(s) - rest(s)) + K (q0 - q(0))

with s the place on the path, ``rest`` the commands that hold the planned posture against gravity,
``full`` those that exert the planned forces too, and g the share of the forces, which ramps up in
the squeeze and down in the release. The fingers close until they touch, wherever that is: q0 is the
posture as read at that moment, and K takes the servos along.

``ObjectLag``: how far the object is from where the plan has it, expressed in joints.

It is the sense ``object`` of a policy (``SenseHistory``). The pose is that of an estimator;
without a camera it is made of joints and touch (``sim.sensing.estimation``). With G the planned map
from joint rates to the object's twist (contacts stick, least squares over the contacts), a
deviation e of the pose is expressed as

    G_t' e_t / l^2,   G_r' e_r / l^2,      e_r and G_r times l, in degrees:

the pattern of joint torques that pushes the object back, for shift and turn apart. So one small
network serves plans with other contacts and other fingers.

``SenseHistory``: the inputs of a policy, as one vector.

The pose of the object comes from the estimator that the policy was trained with; with ``touch``
nothing of the vector comes from a camera once the hand has closed.

joints    joints as read less the playback's posture (nq,), of each of the last decisions
touch     normal force per finger of the hand (fingers,), N, likewise
targets   offset from the playback's commands at the last decision, as an action (nu,)
plan      the playback's posture (nq,), what pressing adds to its commands (nu,), the posture at
          the first touch less the planned one (nq,), and which fingers take part (fingers,)
clock     place on the path, rate, share of the planned forces, whether the object stands (4,)
object    its deviation from the plan, expressed in joints (2 nq,), degrees (``ObjectLag``),
          likewise

``ObjectRange``: an object of which dimensions are drawn: ``cylinder:0.025..0.035x0.08``.
"""

from __future__ import annotations

import math
import re
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from planner.errors import HandError, NotFoundError, ObjectError, TaskError, shown
from planner.hands.hand import Hand
from planner.kinematics import HandState
from planner.motion import Knot, MotionPlan
from planner.objects import GraspObject, parse_object
from planner.plan import GraspPlan
from planner.spatial import SE3, FloatArray, cross, minimum_jerk, skew
from planner.task import GraspTask
from sim.controllers import MotionReference, Observation, Phase
from sim.controllers.follow import CREEP, RAMP, RATE
from sim.controllers.grasp import FIRST_SHARE
from sim.controllers.hand_dynamics import HandLoads

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

    def vector(self, observation: Observation, place: float) -> FloatArray:
        """The deviation at a place of the path, 0 to 1: (2 nq,), degrees.

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
        numbers = np.concatenate([error[:3] @ by_joints[:3], error[3:] @ by_joints[3:]])
        return np.asarray(np.rad2deg(numbers))


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
        """What tells the phases of a manipulation how far the turn has come, by the clock."""
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
        pressing = loads.torque(forces, cross(in_base.positions, forces))
        rest = actuation.commands(q, still, weight)
        rows.append(
            np.concatenate([q, rest, actuation.commands(q, still, weight + pressing) - rest])
        )
    if len(rows) == 1:
        return np.array(rows)
    spline = CubicSpline([place for place, _, _ in knots], np.array(rows))
    return np.asarray(spline(np.linspace(0.0, 1.0, PLACES)))


SENSES: tuple[str, ...] = ("joints", "touch", "targets", "plan", "clock", "object")
"""Senses that a policy may have."""

LAGS: tuple[int, ...] = (0, 2, 6)
"""Ages of joint readings and forces that a policy sees, in decisions."""


_NOTHING = np.zeros(0)
"""Of a sense that is left out."""


def checked_senses(names: Sequence[str]) -> tuple[str, ...]:
    """Senses in their order.

    Raises:
        NotFoundError: There is none of a name.
        TaskError: None is given.
    """
    for name in names:
        if name not in SENSES:
            raise NotFoundError("sense of a policy", name, SENSES)
    if not names:
        raise TaskError(f"a policy needs a sense; give some of {', '.join(SENSES)}")
    return tuple(name for name in SENSES if name in names)


def columns(hand: Hand, senses: Sequence[str]) -> NDArray[np.intp]:
    """Where some senses stand in a vector of all: the inputs of a policy of these alone.

    Raises:
        NotFoundError: There is none of a name.
        TaskError: None is given.
    """
    wanted, at, found = checked_senses(senses), 0, []
    for name, size in _sizes(hand).items():
        if name in wanted:
            found.append(np.arange(at, at + size))
        at += size
    return np.concatenate(found)


def _sizes(hand: Hand) -> dict[str, int]:
    """Numbers of each sense, in order."""
    nq, nu, n = hand.nq, len(hand.actuation.names), len(hand.fingers)
    each = {
        "joints": len(LAGS) * nq,
        "touch": len(LAGS) * n,
        "targets": nu,
        "plan": 2 * nq + nu + n,
        "clock": 4,
        "object": len(LAGS) * 2 * nq,
    }
    return {name: each[name] for name in SENSES}


class SenseHistory:
    """The last readings of one run.

    Attributes:
        size: Length of the vector.
    """

    def __init__(self, task: GraspTask, senses: Sequence[str] = SENSES) -> None:
        """Nothing has been read yet.

        Args:
            task: Hand, and fingers that take part.
            senses: Those that are used, out of ``SENSES``.
        """
        task.require_fingertips("a policy")
        self._senses = checked_senses(senses)
        hand = task.hand
        all_fingers = tuple(hand.fingers)
        self._columns = [all_fingers.index(name) for name in task.finger_names]
        self._part = np.zeros(len(all_fingers))
        self._part[self._columns] = 1.0
        self._kept: deque[tuple[FloatArray, ...]] = deque(maxlen=max(LAGS) + 1)
        each = _sizes(hand)
        self.size = sum(each[name] for name in self._senses)

    def vector(
        self, observation: Observation, playback: Playback, action: FloatArray
    ) -> FloatArray:
        """The inputs now, (size,); call it once a decision.

        Args:
            observation: What sensors read.
            playback: At the time of the observation.
            action: The last decision's (nu,).
        """
        forces = np.zeros(len(self._part))
        forces[self._columns] = observation.normal_forces
        lag = _NOTHING
        if "object" in self._senses:
            lag = playback.lag.vector(observation, playback.place)
        self._kept.appendleft((observation.q - playback.q, forces, lag))
        last = len(self._kept) - 1
        past = [self._kept[min(age, last)] for age in LAGS]
        play = playback
        parts: dict[str, list[FloatArray]] = {
            "joints": [joints for joints, _, _ in past],
            "touch": [force for _, force, _ in past],
            "targets": [action],
            "plan": [play.q, play.press, play.bent, self._part],
            "clock": [np.array([play.place, play.rate, play.share, float(play.standing)])],
            "object": [lag for _, _, lag in past],
        }
        return np.concatenate([part for name in self._senses for part in parts[name]])


_RANGE = re.compile(r"(-?\d*\.?\d+)\.\.(-?\d*\.?\d+)")
"""Two numbers with two dots between them; a sign is read so that the object can refuse it."""

STEP = 5e-5
"""Sizes are rounded to this, m: a tenth of a millimetre in diameter."""


@dataclass(frozen=True)
class ObjectRange:
    """An object as ``parse_object`` takes it; a dimension may be a range ``a..b``, m.

    All ranges are drawn together, so a block that is square stays square.

    Attributes:
        text: As it was given.
    """

    text: str

    def __post_init__(self) -> None:
        """Check both ends.

        Raises:
            PlannerError: An end is no object, or a range whose end is below its beginning.
        """
        for low, high in _RANGE.findall(self.text):
            if float(low) > float(high):
                raise ObjectError(
                    f"the range {low}..{high} of {shown(self.text)} ends below its beginning; give "
                    f"{high}..{low}"
                )
        for share in (0.0, 1.0):
            parse_object(self.at(share))

    def at(self, share: float) -> str:
        """The object at a share of all ranges, 0 to 1."""

        def drawn(found: re.Match[str]) -> str:
            low, high = (float(v) for v in found.groups())
            return f"{STEP * round((low + share * (high - low)) / STEP):.6g}"

        return _RANGE.sub(drawn, self.text)

    def holds(self, item: GraspObject) -> bool:
        """Whether an object is of this kind, and its extents between those of both ends."""
        low, high = (parse_object(self.at(share)).shape for share in (0.0, 1.0))
        shape = item.shape
        return type(shape) is type(low) and bool(
            (shape.half_extents >= low.half_extents - STEP).all()
            and (shape.half_extents <= high.half_extents + STEP).all()
        )
