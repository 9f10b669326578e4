"""``GraspController``: opens, closes until every finger touches, then presses as planned.

Closing is guarded (``sim.controllers.closing``), and done again where joints were off.

Pressing is force control with a spring around the posture in which all fingers touched:

    torque = sum_i J_i(q)^T f_i + gravity(q),   f_i the planned forces, turned with the object
    ctrl   = the actuators' affine law solved for that torque at (q_ref, v = 0)

Solving the law at the latched posture q_ref instead of the measured one leaves every servo its own
stiffness and damping: at q = q_ref it gives exactly the torque that is wanted, elsewhere a spring
adds kp (q_ref - q). That spring is what keeps the object still, since planned forces alone are in
neutral equilibrium. Joints whose actuators have no stiffness (motors) get one here.

``Reclosing``: closes until felt; if the contacts contradict the joints, opens and closes anew.

Called by ``GraspController`` in the phase "close". The first closing finds out where the joints
are (``sim.controllers.calibration``), with light touches that move nothing. If they are off, the
fingers open again, at the joints that were found, and come down where the plan wants them. Exact
joints touch once.

The phase must not end while that goes on: ``closing_ended`` tells a simulation when it may.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from planner.hands.hand import Hand
from planner.joints.actuation import Actuation
from planner.plan import GraspPlan
from planner.spatial import SE3, FloatArray, cross, minimum_jerk
from sim.controllers.base import Observation, Recloses, Sense
from sim.controllers.calibration import Calibration
from sim.controllers.closing import GuardedClosing
from sim.controllers.hand_dynamics import (
    ContactForceLimit,
    FrictionEstimate,
    HandLoads,
    MotorServo,
)
from sim.controllers.joint_stops import StopCorrection, servo_commands
from sim.controllers.readings import TOUCH_FORCE

OPEN_TIME, CLOSE_TIME = 0.3, 0.5
"""Time (s) to open after the first touch, and to close again: as a trial's own closing."""

LONGEST = 1.0
"""Longest time (s) for fingers that do not touch, once the way of a closing is over."""

RECLOSING_TIME = OPEN_TIME + CLOSE_TIME + LONGEST
"""Longest time (s) that a second closing takes."""

LEAST_TOUCHING = 2
"""Fewest fingers whose contacts are worth opening the hand for, if the others do not come."""


class Reclosing:
    """Reference posture while the fingers close, once or twice.

    Attributes:
        again: Whether it opened and closes a second time.
        busy: Whether the second closing goes on, though all fingers may touch.
    """

    def __init__(self, plan: GraspPlan, calibration: Calibration) -> None:
        """Prepare the first closing; the calibration is written."""
        self._plan, self._calibration = plan, calibration
        self._closing = self._first = GuardedClosing(plan)
        self._time, self._arrived = 0.0, 0.0
        self._from = plan.q
        self._compared = False
        self.again = self.busy = False

    @property
    def careful(self) -> bool:
        """Whether a touch came too early for exact joints."""
        return self._closing.careful

    def step(self, elapsed: float, observation: Observation) -> FloatArray:
        """Reference posture (nq,)."""
        if self.again:
            return self._second(elapsed, observation)
        arrived = observation.progress >= 1.0
        self._arrived += elapsed * arrived
        touching = int((observation.normal_forces >= TOUCH_FORCE).sum())
        late = self._arrived > LONGEST - OPEN_TIME and touching >= LEAST_TOUCHING
        if not self._compared and ((arrived and observation.all_touch) or late):
            self._compared = True
            if self._calibration.learn(observation):
                self.again = self.busy = True
                self._from = observation.q.copy()
        return self._closing.step(elapsed, observation)

    def _second(self, elapsed: float, observation: Observation) -> FloatArray:
        """Open, then close at the joints that were found."""
        self._time += elapsed
        since, offset = self._time - OPEN_TIME, self._calibration.offset
        if since < 0.0:
            share = float(minimum_jerk(np.asarray(self._time / OPEN_TIME)))
            return np.asarray(self._from + share * (self._plan.q_pregrasp + offset - self._from))
        if self._closing is self._first:
            self._closing = GuardedClosing(self._plan)
        seen = replace(observation, q=observation.q - offset, progress=min(1.0, since / CLOSE_TIME))
        if observation.all_touch or since > CLOSE_TIME + LONGEST:
            self.busy = False
        return np.asarray(self._closing.step(elapsed, seen) + offset)


def closing_ended(
    controller: object, wait: float, timestep: float
) -> Callable[[Observation], bool]:
    """Whether the phase "close" may end; asked after every step once its duration is over.

    Args:
        controller: Who closes; one that is no ``Recloses`` closes once.
        wait: Longest time (s) for fingers that do not touch; a second closing may take
            ``RECLOSING_TIME`` more.
        timestep: s.
    """
    most, steps = round(wait / timestep), 0

    def over(seen: Observation) -> bool:
        nonlocal steps
        steps += 1
        if isinstance(controller, Recloses) and controller.closing:
            return False
        return seen.all_touch or steps > most

    return over


FIRST_SHARE = 0.1
"""Share of the planned forces at which the squeeze begins: about the force of first touch."""

LIMIT_TOL = 1e-6
"""How far (N, N m) a wanted force may lie beyond its limit: rounding."""


LIGHT_PERIOD = 0.005
"""Longest time between steps (s) at which the contact force is limited before the squeeze. The
limit turns servos into sources of torque with what was just read; at 100 Hz over a network with
late packets that swings, and the object was dropped (examples/20_hand_over_udp.py)."""


class GraspController:
    """Executes the fingers' part of a plan.

    Attributes:
        needs: Senses without which it cannot work.
        uses: What it corrects its joints by, where there is a sense for it.
        plan: What is executed.
        q_ref: Posture (nq,) around which the hand is held at present, as encoders read it.
        calibration: Encoder offsets that the first touch found.
        friction: Dry friction of the joints that was felt before the first touch.
        share: Share (-) of the planned forces that it presses with at present; may be set.
    """

    needs: tuple[Sense, ...] = ("touch", "object_pose")
    uses: tuple[Sense, ...] = ("pads",)

    def __init__(self, plan: GraspPlan) -> None:
        """Prepare forces in the object's frame, search directions and gains."""
        self.plan = plan
        task = plan.task
        self._hand: Hand = task.hand
        self._fingers = task.fingers
        self._gravity = task.gravity
        planned = plan.contacts_in_object
        self._points = planned.positions
        self._forces = planned.forces_in_axes()
        soft = np.array([m == "soft" for m in planned.models])
        torsion = np.where(soft, np.nan_to_num(planned.forces[:, 3]), 0.0)
        self._moments = torsion[:, None] * planned.normals
        self._twists = bool(torsion.any())
        self.calibration = Calibration(plan)
        self._closing = Reclosing(plan, self.calibration)
        self._light = ContactForceLimit(self._hand)
        self.friction = FrictionEstimate(self._hand)
        self._stops = StopCorrection(self._hand.actuation, plan.q)
        self._servo = MotorServo(self._hand, plan.q)
        self._loads = HandLoads(self._hand, self._fingers)
        self._still = np.zeros(self._hand.nq)
        self._torque = np.zeros(self._hand.nq)
        self._latched = False
        self._time = 0.0
        self.share = 1.0
        self.q_ref = plan.q_pregrasp.copy()
        self._law_q = self.q_ref

    def step(self, observation: Observation) -> FloatArray:
        """Commands (nu,) for the hand's actuators."""
        elapsed, self._time = observation.time - self._time, observation.time
        gravity = observation.T_world_base.rotation.T @ self._gravity
        offset = self.calibration.offset
        weight = self._loads.move(observation.q - offset, gravity)
        torque = weight.copy()
        if observation.phase == "close":
            self.q_ref = self._closing.step(elapsed, observation)
        elif observation.phase != "approach":
            if not self._latched:
                self._latched = True
                self._servo.rest()
                self.q_ref = observation.q.copy()
            pressing = self.share * self._pressing_torque(observation)
            if observation.phase == "squeeze":
                ramp = float(minimum_jerk(np.asarray(observation.progress)))
                pressing *= FIRST_SHARE + (1.0 - FIRST_SHARE) * ramp
            torque += pressing
        torque += self._servo.torque(observation.time, self.q_ref, observation.q, observation.v)
        self._torque = torque
        self._law_q = self.q_ref
        if self._latched:
            true = self.q_ref - offset if offset.any() else self.q_ref
            self._law_q = self._stops.corrected(true)
        ctrl = servo_commands(self._hand.actuation, self.q_ref, self._law_q, self._still, torque)
        if self._latched:
            return ctrl
        if elapsed <= LIGHT_PERIOD:
            ctrl = self._light.commands(ctrl, observation.q, observation.v, weight)
        if not observation.normal_forces.any():
            self.friction.update(elapsed, ctrl, observation.q, observation.v, weight)
        return ctrl

    @property
    def closing(self) -> bool:
        """Whether the closing goes on though all fingers touch."""
        return self._closing.busy

    def saturated_actuators(self) -> tuple[str, ...]:
        """Names of the actuators that could not give what the last step wanted."""
        return saturated(self._hand.actuation, self._law_q, self._torque)

    def _pressing_torque(self, observation: Observation) -> FloatArray:
        """Joint torques (nq,) of the full planned forces at the object's present pose.

        The hand must have been moved to the joints of now.
        """
        T_base_object: SE3 = observation.T_world_base.inverse() * observation.T_world_object
        turn = T_base_object.rotation.T
        points = self._points @ turn + T_base_object.translation
        forces = self._forces @ turn
        # wrenches on the object about the base's origin
        moments = cross(points, forces)
        if self._twists:
            moments += self._moments @ turn
        return self._loads.torque(forces, moments)


def saturated(actuation: Actuation, q: FloatArray, torque: FloatArray) -> tuple[str, ...]:
    """Names of the actuators whose limits at q (nq,) are below what a joint torque (nq,) takes."""
    beyond = actuation.short_of(q, torque, LIMIT_TOL)
    return tuple(actuation.names[i] for i in np.flatnonzero(beyond)) if beyond.any() else ()
