"""``GraspController``: opens, closes until every finger touches, then presses as planned.

Closing is guarded: ``sim.controllers.closing`` and ``reclosing``.

Pressing is force control with a spring around the posture in which all fingers touched:

    torque = sum_i J_i(q)^T f_i + gravity(q),   f_i the planned forces, turned with the object
    ctrl   = the actuators' affine law solved for that torque at (q_ref, v = 0)

Solving the law at the latched posture q_ref instead of the measured one leaves every servo its own
stiffness and damping: at q = q_ref it gives exactly the torque that was asked, elsewhere a spring
adds kp (q_ref - q). That spring is what keeps the object still, since planned forces alone are in
neutral equilibrium. Joints whose actuators have no stiffness (motors) get one here.
"""

from __future__ import annotations

import numpy as np

from planner.hands.hand import Hand
from planner.joints.actuation import Actuation
from planner.plan import GraspPlan
from planner.spatial import SE3, FloatArray, cross, minimum_jerk
from sim.controllers.base import Observation, Sense
from sim.controllers.calibration import Calibration
from sim.controllers.hand_dynamics import (
    ContactForceLimit,
    FrictionEstimate,
    HandLoads,
    MotorServo,
)
from sim.controllers.joint_stops import StopCorrection, servo_commands
from sim.controllers.reclosing import Reclosing

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
            pressing = self._pressing_torque(observation)
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
