"""``HoldingTorques``: from contact forces to commands for motors, servos and tendons.

    torque   sum_i J_i^T f_i, the hand's own gravity, a spring on the fingertips that does not move
             the object, a spring on the posture that does not move the fingertips, and a damper
    ctrl     the actuators' law solved for that torque where the joints are: a motor gets the
             torque, a servo the target q + torque / kp, a tendon its share

The spring on the fingertips acts on what their displacements p* - p have beyond those of a rigid
body: f = K (1 - G^T (G G^T)^-1 G) (p* - p), so that G f = 0. The velocity of that rigid body is
what the joints know of the object's in the palm, as long as the contacts stick. Joints of fingers
that take no part are held by their servos' own stiffness, at their latched posture or, during a
motion, at the planned one, clear of the others. Wrist and arm stay where they were. The palms of
two hands that both take part move with the object, and are kept to each other by springs of their
own (``sim.controllers.two_hands``).
All of it is in the axes of the hand's base.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner.plan import GraspPlan
from planner.spatial import SE3, FloatArray, skew
from sim.controllers.calibration import servo_commands
from sim.controllers.grasp import saturated
from sim.controllers.hand_dynamics import FULL_FRICTION_RATE, HandLoads, joint_drag, motor_servo
from sim.controllers.two_hands import PalmSprings, carried_palms

TIP_STIFFNESS = 150.0
"""Spring (N/m) of fingertips against each other: 0.15 N per millimetre of creeping apart."""

JOINT_DAMPING = 0.02
"""Damper (N m s/rad) on every joint of the fingers."""


LEVER = 0.02
"""Motion of a pad along its normal per joint (m/rad) from which on all of the joint's dry friction
is made up for in a search: half a newton at the tip alone moves no joint of 0.02 N m."""

POSTURE_STIFFNESS = 0.3
"""Spring (N m/rad) on what a redundant finger can do by itself, a tenth of a servo's."""

SEARCH_FORCE, SEARCH_DAMPING = 0.5, 15.0
"""A finger that lost the object presses on along its last normal with this force (N), against this
damper (N s/m): it moves at some 3 cm/s."""

RETREAT, RETREAT_STIFFNESS = 0.01, 100.0
"""Distance (m) that a leaving finger keeps from where it held, and the spring (N/m) for that."""

RANK_TOL = 1e-6
"""Added to G G^T (-, m^2) where too few fingers hold to fix every motion."""

FLAT = 1e-8
"""Added to J J^T (m^2): a stretched finger has a direction in which it cannot push, 0.1 mm/rad."""

_RANK, _FLAT = RANK_TOL * np.eye(6), FLAT * np.eye(3)


def grasp_matrix(arms: FloatArray) -> FloatArray:
    """G (6, 3 n): forces in the axes at arms (n, 3) from the centre -> wrench about it."""
    n = len(arms)
    out = np.empty((6, n, 3))
    out[:3] = np.eye(3)[:, None]
    out[3:] = skew(arms).transpose(1, 0, 2)
    return out.reshape(6, 3 * n)


def twist_of(velocities: FloatArray, arms: FloatArray) -> FloatArray:
    """Twist (6,) of the body that points at arms (n, 3) from its centre move like, (n, 3) m/s."""
    grasp = grasp_matrix(arms)
    return np.asarray(np.linalg.solve(grasp @ grasp.T + _RANK, grasp @ velocities.ravel()))


class HoldingTorques:
    """Kinematics of the fingers that take part, and the commands for wanted contact forces.

    Attributes:
        T_base_palm: Pose of the palm; of two hands, whose palms move apart, of their base.
        centers: (n, 3), centres of the pads, m.
        jacobians: (n, 3, nq), of the pads' material points at the contacts.
        turning: (n, 3, nq), of the pads' angular velocity, base axes, through which the torsional
            moment of a soft contact acts.
        springs: Between the palms of two hands that both take part; None else.
        brake: (6,), wrench on the object, N and N m, by the dampers of the servos of two palms.
        own_torque: (nq,), N m, what holds the hand itself, and moves it against its joints' drag.
    """

    def __init__(self, plan: GraspPlan) -> None:
        """Prepare memory."""
        self._hand, self._fingers = plan.task.hand, plan.task.fingers
        self._loads = HandLoads(self._hand, self._fingers)
        self._pads = [(f.pad.joint_id, f.pad.center) for f in self._fingers]
        self.springs = PalmSprings(plan.task) if carried_palms(plan.task) else None
        self._between = np.zeros(self._hand.nq)  # torques of these springs
        self.brake = np.zeros(6)
        n, nq = len(self._fingers), self._hand.nq
        self.T_base_palm = SE3.Identity()
        self.centers = np.zeros((n, 3))
        self.jacobians = np.zeros((n, 3, nq))
        self.turning = np.zeros((n, 3, nq))
        self.own_torque = np.zeros(nq)
        self._drag, self._stiction = joint_drag(self._hand)
        self._found = np.zeros(nq)
        self._v_ref = np.zeros(nq)
        self._own = np.zeros((n, nq), dtype=bool)
        for row, finger in zip(self._own, self._fingers, strict=True):
            row[finger.q_index] = True
        self._moving: NDArray[np.bool_] = np.asarray(self._own.any(axis=0))
        self._driven = np.zeros(nq, dtype=bool)
        for finger in self._hand.fingers.values():
            self._driven[finger.q_index] = True
        self._undamped = np.array(self._moving)  # joints whose servos' own dampers are made up for
        if self.springs is not None:
            self._undamped[self._hand.carriage_index] = False
        self._stiffness, self._damping = motor_servo(self._hand, plan.q)
        self._stiffness[self._moving] = 0.0
        self._damping[self._moving] = JOINT_DAMPING
        self._q_ref = plan.q.copy()
        self._q, self._v, self._v_moving = plan.q.copy(), np.zeros(nq), np.zeros(nq)
        self._tips = np.zeros((n, 3))
        self._apart = np.zeros((n, 3))  # from the fingertips to where they were when latched
        self._tip_forces = np.zeros((n, 3))
        self._tip_velocity = np.zeros((n, 3))
        self._law_q, self._torque = plan.q.copy(), np.zeros(nq)

    def compensate(self, friction: FloatArray) -> None:
        """Take joints to have dry friction (nq,) beyond the model's, N m, from now on."""
        self._stiction = self._stiction + friction
        self._found = self._found + friction

    def move(self, q: FloatArray, v: FloatArray, gravity: FloatArray) -> None:
        """Go to joints (nq,) and rates (nq,), with gravity (3,) in the base's axes, m/s2."""
        self._q, self._v = q, v
        self._v_moving = np.where(self._moving, v, 0.0)
        self.own_torque = self._loads.move(q, gravity)
        if not self._hand.pair:
            self.T_base_palm = self._loads.T_base_palm
        if self.springs is not None:
            self.springs.move(self._loads)
        self._v_ref = np.zeros(self._hand.nq)
        for i, (joint, center) in enumerate(self._pads):
            self.centers[i] = self._loads.at(joint, center)

    def latch(self, finger: int | None = None, *, wrist: bool = True) -> None:
        """Keep the posture and the fingertips as they are now; of one finger, or of all.

        Without ``wrist`` joints that are no finger's are kept where they were to be before: a wrist
        that yields to a load would yield further each time.
        """
        if finger is None:
            kept = self._driven | wrist
            self._q_ref = np.where(kept, self._q, self._q_ref)
            self._tips = self._in_palm(self.centers)
            if self.springs is not None:
                self.springs.latch()
            return
        own = self._own[finger]
        self._q_ref[own] = self._q[own]
        self._tips[finger] = self._in_palm(self.centers)[finger]

    def aim(self, tips: FloatArray, q: FloatArray, v: FloatArray) -> None:
        """Pursue fingertips (n, 3), palm, and a posture (nq,) of all fingers from now on.

        The rates (nq,) at which the posture changes count until the next ``move``: they
        compensate the joints' damping and friction.
        """
        self._tips = tips
        self._q_ref = np.where(self._driven, q, self._q_ref)
        self._v_ref = np.where(self._driven, v, 0.0)
        sign = np.clip(self._v_ref / FULL_FRICTION_RATE, -1.0, 1.0)
        self.own_torque += self._drag * self._v_ref + self._stiction * sign

    @property
    def tips_in_palm(self) -> FloatArray:
        """Where the fingertips (n, 3) are."""
        return self._in_palm(self.centers)

    def touch(
        self, points: FloatArray, center: FloatArray, holding: NDArray[np.bool_]
    ) -> FloatArray:
        """Renew the Jacobians for contact points (n, 3); which fingers hold (n,).

        Returns:
            Twist (6,) of the body that the holding fingertips move like, relative to the palm,
            about ``center``; between two palms the twist that these have in common.
        """
        self._apart = self._latched() - self.centers
        full = np.where(self._loads.moved_by[:, None], self._loads.jacobian, 0.0)
        self.jacobians[:] = full[:, :3] - skew(points) @ full[:, 3:]
        self.turning[:] = full[:, 3:]
        self._tip_velocity[:] = self.jacobians @ self._v_moving
        mask = holding[:, None]
        grasp = grasp_matrix(points - center) * np.repeat(holding, 3)
        held = np.where(mask, self._apart, 0.0)
        moved = np.column_stack([self._tip_velocity.ravel(), held.ravel()])
        rigid = np.linalg.solve(grasp @ grasp.T + _RANK, grasp @ moved)
        rest = held - (rigid[:, 1] @ grasp).reshape(-1, 3)
        self._tip_forces[:] = np.where(mask, TIP_STIFFNESS * rest, 0.0)
        if self.springs is None:
            return np.asarray(rigid[:, 0])
        self._between, common, self.brake = self.springs.pull(center, self._v)
        return common

    def commands(
        self,
        forces: FloatArray,
        normals: FloatArray,
        holding: NDArray[np.bool_],
        searching: NDArray[np.bool_],
        corrected: FloatArray | None = None,
        read: FloatArray | None = None,
        moments: FloatArray | None = None,
        further: FloatArray | None = None,
    ) -> FloatArray:
        """Commands (nu,) that press.

        Args:
            forces: (n, 3), wanted forces on the object, N, of the fingers that hold.
            normals: (n, 3), into the object.
            holding: (n,), which fingers hold.
            searching: (n,), which look for the object; the rest stay off it.
            corrected: (nq,), joints as the stops have them (``sim.controllers.calibration``); those
                of ``move`` if None.
            read: (nq,), joints as the servos' encoders have them; those of ``move`` if None.
            moments: (n,), torsional moments of soft contacts on the object about their normals,
                N m, of the fingers that hold; none if None.
            further: Joint torques (nq,) beside, N m.
        """
        torque = self._tip_torque(forces, normals, holding, searching) + self._posture_torque()
        torque += self._between if further is None else self._between + further
        if moments is not None:
            about = np.where(holding, moments, 0.0)[:, None] * normals
            torque += about.ravel() @ self.turning.reshape(-1, len(self._q))
        torque = torque + self._stiffness * (self._q_ref - self._q)
        torque = np.asarray(torque - self._damping * (self._v - self._v_ref))
        if searching.any() and self._found.any():
            torque += self._to_search(normals, searching)
        self._torque = torque
        self._law_q = np.where(self._moving, self._q, self._q_ref)
        encoders = self._law_q
        if read is not None and read is not self._q:
            encoders = self._law_q + (read - self._q)
        if corrected is not None and corrected is not self._q:
            self._law_q = np.where(self._moving, corrected, self._q_ref)
        law_v = np.where(self._undamped, self._v, 0.0)
        return servo_commands(self._hand.actuation, encoders, self._law_q, law_v, torque)

    def _tip_torque(
        self,
        forces: FloatArray,
        normals: FloatArray,
        holding: NDArray[np.bool_],
        searching: NDArray[np.bool_],
    ) -> FloatArray:
        """Joint torques (nq,) of the fingertips' forces, and of the hand itself."""
        seek = SEARCH_FORCE * normals
        away = RETREAT_STIFFNESS * (self._apart - RETREAT * normals)
        alone = np.where(searching[:, None], seek, away) - SEARCH_DAMPING * self._tip_velocity
        total = np.where(holding[:, None], forces + self._tip_forces, alone)
        return total.ravel() @ self.jacobians.reshape(-1, len(self._q)) + self.own_torque

    def _posture_torque(self) -> FloatArray:
        """Joint torques (nq,) of a spring on the posture that does not move the fingertips."""
        posture = np.where(self._own, POSTURE_STIFFNESS * (self._q_ref - self._q), 0.0)  # (n, nq)
        jac = np.where(self._own[:, None], self.jacobians, 0.0)
        gram = jac @ jac.transpose(0, 2, 1) + _FLAT
        force = np.linalg.solve(gram, jac @ posture[..., None])
        idle = posture - (jac.transpose(0, 2, 1) @ force)[..., 0]
        return np.asarray(idle.sum(axis=0))

    def held_back(self, normals: FloatArray) -> FloatArray:
        """What the friction found may take from each finger's normal force at rest, (n,), N.

        A finger whose joints are stuck presses with any force F along n for which every joint j
        bears the difference to the torque that it gets: |J_j^T n| |F - F_wanted| <= friction_j.
        The joint with the longest lever bears least. Fingers that nothing moves along n give 0.
        """
        if not self._found.any():
            return np.zeros(len(normals))
        levers = np.where(self._own, np.abs((normals[:, None] @ self.jacobians)[:, 0]), 0.0)
        ends = levers.argmax(axis=1)
        longest = levers[np.arange(len(levers)), ends]
        return np.where(longest > LEVER, self._found[ends] / np.maximum(longest, LEVER), 0.0)

    def _to_search(self, normals: FloatArray, searching: NDArray[np.bool_]) -> FloatArray:
        """Joint torques (nq,) that overcome the friction found, for fingers that search."""
        levers = (normals[:, None] @ self.jacobians)[:, 0] * searching[:, None]  # m/rad
        lean = np.where(self._own, np.clip(levers / LEVER, -1.0, 1.0), 0.0).sum(axis=0)
        return np.asarray(lean * self._found)

    def saturated_actuators(self) -> tuple[str, ...]:
        """Names of the actuators that could not give what the last command wanted."""
        return saturated(self._hand.actuation, self._law_q, self._torque)

    def _in_palm(self, points: FloatArray) -> FloatArray:
        """Points (n, 3) of the base in the palm."""
        T = self.T_base_palm
        return np.asarray((points - T.translation) @ T.rotation)

    def _latched(self) -> FloatArray:
        """Where the fingertips (n, 3) were when latched, with the palm where it is now."""
        T = self.T_base_palm
        return np.asarray(self._tips @ T.rotation.T + T.translation)
