"""Senses without taxels: ``effort``, forces from the motors' torques, and ``binary``.

``binary`` says which pads touch, and nothing else; it is the cheapest there is. A pad touches from
``ON`` on and until its force falls below ``OFF``. Force, place and normal are those of the plan:
the planned grip along the planned normal, turned as the fingertips have turned about each other
(``PlannedPads``).

``effort`` has contact forces from the torques of the motors alone. At every step, per finger, the
force f at the pad's centre that explains best what the motors do beyond holding and moving the
finger itself:

    N^T J^T f = N^T (R^T F + springs - b v - c sign(v) - g - M a)

with F the forces of the actuators, g the torque of the finger's weight, b, c and M damping, dry
friction and inertia of its joints as the model has them, a their low-passed acceleration. N spans
the motions that couplings, stops and joints at their limits leave: what these carry no motor feels.
The friction of a joint that moves is known; that of a joint at rest is as large as it can be: what
it explains is no touch. The normal is the planned one (``PlannedPads``), and the contact where
it leaves the pad.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from planner.spatial import FloatArray, skew
from sim.controllers import Observation
from sim.controllers.hand_dynamics import HandLoads, joint_drag
from sim.sensing.touch.senses import PlannedPads, TouchContext, register_touch

LEAST_FORCE, LOST_FORCE = 0.12, 0.04
"""Force (N) along the normal from which on a finger touches, and below which it touches no more. A
finger that closes in the air reads less; one that closes lightly on an object reads 0.15 to 0.25
(Allegro hand, 0.02 N m of dry friction)."""

SMOOTHING = 0.01
"""Time constant (s) of the average of force and acceleration."""

AT_LIMIT = 0.01
"""A joint this near (rad) to its limit may be carried by it."""

SLOWEST = 0.1
"""Rate (rad/s) from which on the dry friction of a joint is full: below, it creeps, in
simulators too, with less."""

FLAT = 1e-6
"""Added to the normal equations (m2): a stretched finger has a direction that no motor feels."""


class EffortSense:
    """Forces from motor torques."""

    def __init__(self, context: TouchContext) -> None:
        """Nothing is felt yet."""
        plan = context.plan
        self._scene, self._data, self._task = context.scene, context.data, plan.task
        hand = plan.task.hand
        self._pads = PlannedPads(context)
        self._loads = HandLoads(hand, plan.task.fingers)
        self._pin = hand.pin_model.createData()
        self._drag, modelled = joint_drag(hand)
        self._stiction = modelled + context.dry_friction
        self._rows = np.array([c.row for c in hand.couplings]).reshape(-1, hand.nq)
        self._force = np.zeros((len(plan.task.fingers), 3))
        self._touching = np.zeros(len(plan.task.fingers), dtype=bool)
        self._v, self._rate, self._time = np.zeros(hand.nq), np.zeros(hand.nq), -1.0

    def read(self, truth: Observation) -> Observation:
        """The observation with what the motors feel."""
        first = self._time < 0
        elapsed = 0.0 if first else truth.time - self._time
        share = elapsed / (SMOOTHING + elapsed)
        if elapsed > 0:
            self._rate += share * ((truth.v - self._v) / elapsed - self._rate)
        self._v, self._time = truth.v, truth.time
        force = self._forces(truth)
        self._force = force if first else self._force + share * (force - self._force)
        normal, position = self._pads.expected(truth.T_world_base)
        along = (self._force * normal).sum(axis=1)
        self._touching = along >= np.where(self._touching, LOST_FORCE, LEAST_FORCE)
        return self._pads.observation(truth, self._touching, self._force, normal, position)

    def _forces(self, truth: Observation) -> FloatArray:
        """Forces (n, 3) on what touches that explain the torques now, N, world."""
        hand, q, v = self._task.hand, truth.q, truth.v
        base = truth.T_world_base
        turn = base.rotation
        own = self._loads.move(q, turn.T @ self._task.gravity)
        effort = self._data.actuator_force[self._scene.hand_ctrl]
        torque = hand.actuation.moment.T @ effort + hand.actuation.passive_torque(q)
        inertia = pin.crba(hand.pin_model, self._pin, q)
        inertia = np.triu(inertia) + np.triu(inertia, 1).T
        torque = torque - self._drag * v - own - inertia @ self._rate
        torque -= self._rubs(torque, v)
        at_limit = (q < hand.q_lower + AT_LIMIT) | (q > hand.q_upper - AT_LIMIT)
        out = np.zeros((len(self._task.fingers), 3))
        for k, finger in enumerate(self._task.fingers):
            mine = finger.q_index
            center = self._loads.at(finger.pad.joint_id, finger.pad.center)
            jacobian = self._loads.jacobian[:, mine]
            point = jacobian[:3] - skew(center) @ jacobian[3:]
            held = np.eye(len(mine))[at_limit[mine]]
            free = _left_by(np.concatenate([self._rows[:, mine], held]))
            seen = free.T @ point.T  # (motions, 3)
            wanted = free.T @ torque[mine]
            force = np.linalg.solve(seen.T @ seen + FLAT * np.eye(3), seen.T @ wanted)
            out[k] = turn @ force
        return out

    def _rubs(self, torque: FloatArray, v: FloatArray) -> FloatArray:
        """Dry friction (nq,), N m, of joints with rates v (nq,) that are moved by torques (nq,)."""
        at_rest = np.clip(torque, -self._stiction, self._stiction)
        return np.where(np.abs(v) > SLOWEST, self._stiction * np.sign(v), at_rest)


def _left_by(rows: FloatArray) -> FloatArray:
    """Orthonormal motions (joints, m) that keep some rows (k, joints) as they are."""
    count = rows.shape[1]
    if not rows.any():
        return np.eye(count)
    _, sizes, basis = np.linalg.svd(rows)
    return np.asarray(basis[int((sizes > 1e-9).sum()) :].T)


register_touch("effort", EffortSense)


ON, OFF = 0.08, 0.04
"""Normal force (N) from which on a pad says that it touches, and below which it stops."""


class BinarySense:
    """Contact, yes or no."""

    def __init__(self, context: TouchContext) -> None:
        """Nothing touches yet."""
        task = context.plan.task
        self._pads = PlannedPads(context)
        self._grip = task.grip_force
        self._touching = np.zeros(len(task.fingers), dtype=bool)

    def read(self, truth: Observation) -> Observation:
        """The observation with contact, yes or no."""
        felt = truth.normal_forces
        self._touching = np.where(self._touching, felt >= OFF, felt >= ON)
        normal, position = self._pads.expected(truth.T_world_base)
        force = self._grip * normal
        return self._pads.observation(truth, self._touching, force, normal, position)


register_touch("binary", BinarySense)
