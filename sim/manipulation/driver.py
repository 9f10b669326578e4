"""Drives of a manipulation: the fingers over all phases, and the base or the arm.

Up to the release an ``InHandController`` drives the fingers, with targets from a
``MotionReference`` during the turn; then the fingers open to the planned posture.

``FingerSwing``: moves a finger that is off the object along its planned way until it lands.

Its actuators follow the way by servos instead of the contact forces. The way is that of a
``Relocation``, from the measured posture at the start. Beyond its end the pad moves on slowly along
the normal until it feels the object.

``out_of_the_way``: idle fingers keep away from the fingers of a motion. The planner keeps 2 mm
between fingers. A finger that turns an object deviates from its planned posture by some degrees,
more if the object is off its planned place, and would push a neighbour 2 mm away. So idle fingers
spread from their planned postures as far as that helps. The planned motion of the other fingers
stays.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline, PchipInterpolator

from planner.collision.arm_path import ArmPath
from planner.collision.pair_table import TABLE
from planner.collision.pregrasp_ik import idle_joints, spread_idle
from planner.collision.world import CollisionWorld
from planner.errors import TaskError
from planner.kinematics import PEAK, MovingHand, palm_paths, palm_pose, posture_times
from planner.motion.manipulation import ManipulationPlan
from planner.motion.phase import Knot, Relocation
from planner.motion.plan import MovementPlan
from planner.plan import GraspPlan
from planner.search.beyond import SEARCH_DAMPING
from planner.spatial import SE3, FloatArray, minimum_jerk
from planner.task import GraspTask
from sim.controllers import Event, HasOwnAim, Observation, Phase, Recloses
from sim.controllers.follow import MotionReference
from sim.controllers.hand_dynamics import MotorServo, motor_servo
from sim.manipulation.in_hand import InHandController
from sim.scene.build import Scene
from sim.scene.carrier import ArmCarrier, Timeline
from sim.scene.gantry import Gantry
from sim.simulation import Simulation

BEYOND, TILTED_BEYOND = np.deg2rad(0.5), np.deg2rad(1.0)
"""Turn (rad) beyond the asked one, a margin against elastic return; and about an axis that is not
vertical in the attitude, where the weight turns the object back further."""

SURE, MOST_SURE = 2.0, np.deg2rad(2.0)
"""Standard deviations of the turn as it is believed by which the goal lies further, so that nearly
all turns reach their angle, and the most (rad) that comes of it: the median may be 4 degrees off.
With exact poses it is 0. Under ``lab`` 4 of 20 turns else ended 0.01 to 0.1 degrees short."""


class ManipulationDriver:
    """Drives the hand through a ``ManipulationPlan``: closes, holds, turns, lets go.

    Attributes:
        holding: What holds and turns the object.
        reference: What gives it targets during the turn, or during the stroke that it is in.
        swing: Moves a finger that is off the object; None while there is none.
    """

    def __init__(self, plan: ManipulationPlan, holding: InHandController, *, rate: float) -> None:
        """Prepare.

        Args:
            plan: What to execute.
            holding: What holds and turns the object.
            rate: Largest rate of the turn, rad/s.
        """
        self.holding = holding
        self.swing: FingerSwing | None = None
        self._plan, self._rate = plan, rate
        # swings of a tool's gait were verified with idle fingers where they are planned
        self._motion = plan if plan.task.needed else out_of_the_way(plan)
        self.reference = self.begin_stroke(plan.angle)
        release = plan.ending.release
        self._opening = PostureServo(plan.grasp, plan.grasp.q if release is None else release.q)

    @property
    def events(self) -> tuple[Event, ...]:
        """What was noticed, in order."""
        return self.holding.events

    @property
    def closing(self) -> bool:
        """Whether the fingers close a second time."""
        return isinstance(self.holding, Recloses) and self.holding.closing

    @property
    def aims_by_belief(self) -> bool:
        """Whether a turn that is not known well goes further."""
        return not isinstance(self.holding, HasOwnAim)

    def begin_stroke(self, left: float, deviation: float = 0.0) -> MotionReference:
        """Begin a stroke: a reference along the planned motion, from where the object is.

        Args:
            left: Turn that is still to be made, rad, with its sign; as much of it is made as a
                stroke has.
            deviation: Believed standard deviation of the turn as it will be read, rad.
        """
        motion = self._motion
        beyond = TILTED_BEYOND if motion.path.weight_turns_back else BEYOND
        beyond += min(SURE * deviation, MOST_SURE)
        most = min(abs(left) + beyond, abs(motion.path.angle))
        angle = math.copysign(most, self._plan.angle)
        self.reference = MotionReference(motion, angle=angle, rate=self._rate)
        self.holding.reference = self.reference
        return self.reference

    def begin_back(self) -> MotionReference:
        """Begin the way back: a reference to where the motion began, from where the object is."""
        self.reference = MotionReference(
            self._motion, rate=self._rate, back_from=self.reference.place
        )
        self.holding.reference = self.reference
        return self.reference

    @property
    def off(self) -> NDArray[np.bool_]:
        """Which fingers (n,) are to be off the object: told to leave, or on their way."""
        swinging = "" if self.swing is None else self.swing.finger
        names = np.array(self._plan.task.finger_names)
        return np.asarray(~self.holding.schedule.wanted | (names == swinging))

    def step(self, observation: Observation) -> FloatArray:
        """Commands (nu,) for the hand's actuators."""
        if observation.phase in ("open", "retreat"):
            share = observation.progress if observation.phase == "open" else 1.0
            return self._opening.command(observation, share)
        ctrl = self.holding.step(observation)
        if self.swing is None:
            return ctrl
        return np.where(self.swing.actuators, self.swing.command(observation), ctrl)

    def saturated_actuators(self) -> tuple[str, ...]:
        """Names of the actuators that could not give what the last step wanted."""
        return self.holding.saturated_actuators()


class PostureServo:
    """Goes to a posture evenly in all joints; motors by a ``MotorServo``."""

    def __init__(self, plan: GraspPlan, goal: FloatArray) -> None:
        """Prepare gains.

        Args:
            plan: Whose hand it is.
            goal: Posture (nq,); the fingers that take part go there, other joints stay.
        """
        task = plan.task
        self._hand, self._gravity = task.hand, task.gravity
        self._goal = goal
        self._index = np.concatenate([f.q_index for f in task.fingers])
        self._servo = MotorServo(task.hand, plan.q)
        self._state = MovingHand(task.hand, plan.q)
        self._begin: FloatArray | None = None

    def command(self, observation: Observation, share: float) -> FloatArray:
        """Commands (nu,) for a share of the way, in [0, 1]."""
        if self._begin is None:
            self._begin = observation.q.copy()
        q = self._begin.copy()
        way = float(minimum_jerk(np.asarray(share)))
        q[self._index] += way * (self._goal - self._begin)[self._index]
        gravity = observation.T_world_base.rotation.T @ self._gravity
        torque = self._state.move(observation.q).gravity_torque(gravity)
        torque += self._servo.torque(observation.time, q, observation.q, observation.v)
        ctrl = self._hand.actuation.commands(q, np.zeros(self._hand.nq), torque)
        return ctrl


class BaseMover:
    """Moves the gantry from pose to pose: a ``sim.scene.carrier.Carrier``.

    Attributes:
        fault: Why the hand cannot be brought where it was sent last, "" if it can.
        duration: Time that its last way takes, s.
    """

    def __init__(self, gantry: Gantry, T_world_base: SE3) -> None:
        """Stay at a pose."""
        self.fault = ""
        self._gantry = gantry
        self._way: FloatArray = gantry.coordinates(T_world_base)[None]
        self._smooth: CubicSpline | None = None
        self.duration = 1.0

    def stay(self) -> None:
        """Stay where it was sent last."""
        self._way, self._smooth = self._way[-1:], None

    def go(self, T_world_base: SE3, duration: float) -> None:
        """From where it was sent last to a pose, in a time (s) that is the phase's own."""
        self._way = np.vstack([self._way[-1], self._gantry.coordinates(T_world_base)])
        self._way[:, 3:] = np.unwrap(self._way[:, 3:], axis=0)  # near half a turn either sign is
        self._smooth, self.duration = None, duration

    def go_along(self, poses: Sequence[SE3], duration: float) -> None:
        """From where it was sent last through poses evenly, the first of which is about there."""
        way = np.array([self._gantry.coordinates(pose) for pose in poses[1:]])
        way[:, 3:] = np.unwrap(way[:, 3:], axis=0)  # the first hinge may turn by half a turn
        self._way, self.duration = np.vstack([self._way[-1], way]), duration
        self._smooth = CubicSpline(np.linspace(0.0, 1.0, len(self._way)), self._way)

    def T_world_base(self, simulation: Simulation) -> SE3:
        """Where the base is now."""
        return simulation.T_world_base

    def drive(self, data: Any, phase: Phase, share: float) -> None:
        """Set the gantry's commands for a share of the way."""
        del phase
        s, rate = Timeline.profile(share)
        if self._smooth is not None:
            target, velocity = self._smooth(s), rate / self.duration * self._smooth(s, 1)
        else:
            way = self._way[-1] - self._way[0]
            target, velocity = self._way[0] + s * way, rate / self.duration * way
        data.ctrl[self._gantry.ctrl] = self._gantry.command(data, target, velocity)


class ArmMover(ArmCarrier):
    """The same by the arm that the hand is on; its root stands.

    Poses of the base are those of a base without an arm that moves with the palm, and that is at
    the arm's root in the grasp.

    Attributes:
        fault: As ``BaseMover``.
        duration: As there; longer than was asked for where a joint would be too fast.
    """

    def __init__(self, plan: GraspPlan, path: ArmPath, scene: Scene) -> None:
        """Stay where the approach begins."""
        super().__init__(plan, path, scene, Timeline())
        self.fault = ""
        self._root, self._q_grasp = plan.T_world_base, plan.q
        self._T_root_palm = palm_pose(plan.task.hand, plan.q)
        self._way = path.approach[:1]
        self.duration = 1.0

    def stay(self) -> None:
        """Stay where it was sent last."""
        self._way = self._way[-1:]

    def go(self, T_world_base: SE3, duration: float) -> None:
        """From where it was sent last straight to a pose, in a time (s)."""
        self.go_along([T_world_base, T_world_base], duration)

    def go_along(self, poses: Sequence[SE3], duration: float) -> None:
        """From where it was sent last through poses, the first of which is about there."""
        self.fault = ""
        q, whole = self._q_grasp.copy(), [self._way[-1:]]
        q[self._hand.arm_index] = self._way[-1]
        goals = [self._root.inverse() * pose * self._T_root_palm for pose in poses[1:]]
        for way in palm_paths(self._hand, q, goals):
            if way is None:
                self.fault = "the arm cannot bring the hand there within its limits"
                return
            whole.append(way[1:])
        way = np.concatenate(whole)
        times = posture_times(way, duration)
        self._way, self.duration = way, float(times[-1])
        # rates that jump from row to row shake the object: 20 mm/s of slip in a carry of 12 cm
        self._smooth = CubicSpline(times / times[-1], way)

    def T_world_base(self, simulation: Simulation) -> SE3:
        """Where the base is now, by the palm."""
        scene = simulation.scene
        T_world_palm = scene.body_pose(simulation.data, scene.palm_body)
        return T_world_palm * self._T_root_palm.inverse()

    def motion(self, phase: Phase, share: float) -> tuple[FloatArray, FloatArray]:
        """Arm joints (n,) and their rates (n,) at a share of the way."""
        del phase
        if len(self._way) < 2:
            return self._way[-1], np.zeros(self._way.shape[1])
        s, rate = Timeline.profile(share)
        return self._smooth(s), rate / self.duration * self._smooth(s, 1)


def mover_of(plan: GraspPlan, scene: Scene) -> BaseMover | ArmMover:
    """What brings the hand of a plan from pose to pose.

    Raises:
        TaskError: The plan holds no way of the arm that its hand is on.
    """
    if scene.gantry is not None:
        return BaseMover(scene.gantry, plan.T_world_base_start)
    if plan.arm is None:
        raise TaskError(f"the plan holds no way of the arm of {plan.task.hand.name}; plan again")
    return ArmMover(plan, plan.arm, scene)


LANDING_SPEED = 0.02
"""Speed (m/s) along the normal of a pad that has come to the end of its way without touching."""

DEEPEST = 0.008
"""How far (m) it goes: more than object and hand are beside their places."""

RATE_STEP = 1e-3
"""Share of the time (-) over which a rate is taken."""

SHORTEST = 1e-3
"""Change of joints (rad) that a piece of the way counts at least."""

QUICKEST = 0.15
"""Least time (s) for a way: what a servo of a finger follows."""


class FingerSwing:
    """Moves one finger; starts at the first command.

    Attributes:
        finger: Its name.
        duration: Time for its way, s.
        share: How much of that has passed, in [0, 1].
        actuators: (nu,), which are the finger's.
    """

    def __init__(self, plan: GraspPlan, relocation: Relocation, rate: float) -> None:
        """Prepare the way.

        Args:
            plan: Whose hand it is.
            relocation: The way.
            rate: Largest rate of its joints, rad/s; they go evenly along the way.
        """
        task = plan.task
        hand, finger = task.hand, task.hand.fingers[relocation.finger]
        self.finger = relocation.finger
        self._hand, self._gravity = hand, task.gravity
        self._index = finger.q_index
        self.actuators: NDArray[np.bool_] = (hand.actuation.moment[:, self._index] != 0).any(axis=1)
        way = relocation.postures[:, self._index]
        pieces = np.maximum(np.abs(np.diff(way, axis=0)).max(axis=1), SHORTEST)
        gone = np.concatenate([[0.0], np.cumsum(pieces)])
        self._way = PchipInterpolator(gone / gone[-1], way)
        self._middle = float(gone[len(way) // 2] / gone[-1])
        self.duration = max(QUICKEST, PEAK * float(gone[-1]) / rate)
        self._state = MovingHand(hand, relocation.postures[-1])
        self._stiffness, self._damping = motor_servo(hand, plan.q)
        landing = relocation.landing
        T_base_world = plan.T_world_base.inverse()
        jac = self._state.point_jacobian(finger.pad.joint_id, T_base_world.act(landing.position))
        jac = jac[:3, self._index]
        gram = jac @ jac.T + SEARCH_DAMPING**2 * np.eye(3)
        self._inwards = jac.T @ np.linalg.solve(gram, T_base_world.rotation @ landing.frame[:, 0])
        self._bent: FloatArray | None = None
        self._time = 0.0
        self._reach = 0.0
        self.share = 0.0

    @property
    def over(self) -> bool:
        """Whether it is half-way at least: lifted, and near where it goes down."""
        return float(minimum_jerk(np.asarray(self.share))) >= self._middle

    def command(self, observation: Observation) -> FloatArray:
        """Commands (nu,) of which the finger's count."""
        k = self._index
        if self._bent is None:
            self._bent, self._time = observation.q[k] - self._way(0.0), observation.time
        elapsed, self._time = observation.time - self._time, observation.time
        if self.share < 1.0:
            self.share = min(1.0, self.share + elapsed / self.duration)
        else:
            self._reach = min(DEEPEST, self._reach + LANDING_SPEED * elapsed)
        here, there = (self._at(s, self._bent) for s in (self.share, self.share + RATE_STEP))
        q, v = observation.q.copy(), np.zeros(self._hand.nq)
        q[k] = here + self._reach * self._inwards
        v[k] = (there - here) / (RATE_STEP * self.duration)
        gravity = observation.T_world_base.rotation.T @ self._gravity
        torque = self._state.move(observation.q).gravity_torque(gravity)
        torque += self._hand.pin_model.damping * v
        torque += self._stiffness * (q - observation.q) + self._damping * (v - observation.v)
        ctrl = self._hand.actuation.commands(q, v, torque)
        return ctrl

    def _at(self, share: float, bent: FloatArray) -> FloatArray:
        """Joints (k,) at a share of the time, with what is left there of a difference (k,)."""
        s = float(minimum_jerk(np.asarray(min(1.0, share))))
        return np.asarray(self._way(s) + (1.0 - s) * bent)


def out_of_the_way(motion: MovementPlan) -> MovementPlan:
    """The motion with idle fingers moved away from everything else.

    The first knot stays: it is the grasp. From one knot to the next they move by at most two steps
    of a joint, 4 degrees. A hand without idle fingers gets its motion back. The table counts only
    where one would be in it as the object is put down: in the air there is none.
    """
    task = motion.grasp.task
    if not idle_joints(task.hand, task.finger_names):
        return motion
    led = _led(motion, replace(task, table_height=None, obstacles=()))
    if task.table_height is None:
        return led
    end = led.knots[-1]
    nearest = CollisionWorld(task).nearest_of(_base_at(motion, end), end.q, frozenset({TABLE}))
    return led if nearest.distance > 0.0 else _led(motion, task)


def _led(motion: MovementPlan, task: GraspTask) -> MovementPlan:
    """The motion with idle fingers away from everything else that a task has."""
    world = CollisionWorld(task)
    offset, knots = np.zeros(task.hand.nq), [motion.knots[0]]
    for knot in motion.knots[1:]:
        q = spread_idle(world, _base_at(motion, knot), knot.q + offset)
        offset = q - knot.q
        knots.append(replace(knot, q=q))
    return motion.with_knots(knots)


def _base_at(motion: MovementPlan, knot: Knot) -> SE3:
    """Pose of the base at a knot with the object where the task has it, on the table."""
    first = motion.grasp.task.T_world_object
    return first * knot.T_world_object.inverse() * motion.T_world_base
