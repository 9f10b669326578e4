"""``GraspController``: opens, closes until every finger touches, then presses as planned.

Closing is guarded: every finger moves from pre-grasp to grasp until it touches; one that arrives
without touching goes on slowly along its contact normal.

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

from planner.actuation import Actuation
from planner.hands.hand import Hand
from planner.kinematics.state import HandState
from planner.plan import GraspPlan
from planner.spatial import SE3, FloatArray, minimum_jerk
from sim.controllers.base import Observation, Sense
from sim.controllers.loads import HandLoads, crossed
from sim.controllers.motors import MotorServo
from sim.controllers.schedule import TOUCH_FORCE

__all__ = ["GraspController", "saturated"]

CLOSE_RATE = 4.0
"""Fastest change (1/s) of a finger's share of the closing motion, for one that lost touch."""

SEARCH_SPEED = 0.01
"""Speed (m/s) along the normal of a finger that has arrived without touching."""

SEARCH_REACH = 0.01
"""How far (m) it searches beyond its planned contact."""

SEARCH_DAMPING = 0.01
"""Damping (m/rad) of the inverse that turns the search into joint motion; keeps a straight finger
from swinging."""

FIRST_SHARE = 0.1
"""Share of the planned forces at which the squeeze begins: about the force of first touch."""

LIMIT_TOL = 1e-6
"""How far (N, N m) a wanted force may lie beyond its limit: rounding."""


class GraspController:
    """Executes the fingers' part of a plan.

    Attributes:
        needs: Senses without which it cannot work.
        plan: What is executed.
        q_ref: Posture (nq,) around which the hand is held at present.
    """

    needs: tuple[Sense, ...] = ("touch", "object_pose")

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
        self._search = self._search_directions()
        self._share = np.zeros(len(self._fingers))
        self._reach = np.zeros(len(self._fingers))
        self._servo = MotorServo(self._hand, plan.q)
        self._loads = HandLoads(self._hand, self._fingers)
        self._still = np.zeros(self._hand.nq)
        self._torque = np.zeros(self._hand.nq)
        self._latched = False
        self._time = 0.0
        self.q_ref = plan.q_pregrasp.copy()

    def step(self, observation: Observation) -> FloatArray:
        """Commands (nu,) for the hand's actuators."""
        elapsed, self._time = observation.time - self._time, observation.time
        gravity = observation.T_world_base.rotation.T @ self._gravity
        torque = self._loads.move(observation.q, gravity)
        if observation.phase == "close":
            self._close(observation, elapsed)
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
        return self._hand.actuation.commands(self.q_ref, self._still, torque)

    def saturated_actuators(self) -> tuple[str, ...]:
        """Names of the actuators that could not give what the last step wanted."""
        return saturated(self._hand.actuation, self.q_ref, self._torque)

    def _close(self, observation: Observation, elapsed: float) -> None:
        """Advance every finger that does not touch."""
        goal = float(minimum_jerk(np.asarray(observation.progress)))
        free = observation.normal_forces < TOUCH_FORCE
        arrived = self._share >= 1.0
        self._share[free] = np.minimum(goal, self._share + CLOSE_RATE * elapsed)[free]
        self._reach[free & arrived] += SEARCH_SPEED * elapsed
        self._reach = np.minimum(self._reach, SEARCH_REACH)
        plan = self.plan
        q = plan.q_pregrasp + goal * (plan.q - plan.q_pregrasp)
        for finger, share in zip(self._fingers, self._share, strict=True):
            k = finger.q_index
            q[k] = plan.q_pregrasp[k] + share * (plan.q[k] - plan.q_pregrasp[k])
        self.q_ref = q + self._reach @ self._search

    def _pressing_torque(self, observation: Observation) -> FloatArray:
        """Joint torques (nq,) of the full planned forces at the object's present pose.

        The hand must have been moved to the joints of now.
        """
        T_base_object: SE3 = observation.T_world_base.inverse() * observation.T_world_object
        turn = T_base_object.rotation.T
        points = self._points @ turn + T_base_object.translation
        forces = self._forces @ turn
        # wrenches on the object about the base's origin
        moments = crossed(points, forces)
        if self._twists:
            moments += self._moments @ turn
        return self._loads.torque(forces, moments)

    def _search_directions(self) -> FloatArray:
        """Joint motion (n_fingers, nq), rad/m, that moves each pad along its normal."""
        plan = self.plan
        state = HandState(self._hand, plan.q)
        inverse = plan.T_world_base.inverse()
        out = np.zeros((len(self._fingers), self._hand.nq))
        for row, finger, point, normal in zip(
            out, self._fingers, plan.contacts.positions, plan.contacts.normals, strict=True
        ):
            jacobian = state.point_jacobian(finger.pad.joint_id, inverse.act(point))[:3]
            jacobian = jacobian[:, finger.q_index]
            gram = jacobian @ jacobian.T + SEARCH_DAMPING**2 * np.eye(3)
            row[finger.q_index] = jacobian.T @ np.linalg.solve(gram, inverse.rotation @ normal)
        return out


def saturated(actuation: Actuation, q: FloatArray, torque: FloatArray) -> tuple[str, ...]:
    """Names of the actuators whose limits at q (nq,) are below what a joint torque (nq,) takes."""
    beyond = actuation.short_of(q, torque, LIMIT_TOL)
    return tuple(actuation.names[i] for i in np.flatnonzero(beyond)) if beyond.any() else ()
