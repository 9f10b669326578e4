"""What the closed loop needs for two hands: the object's path in the world, springs between palms.

``PalmSprings``: springs and dampers that keep the palms of two hands to each other, and leave the
motion of the object between them to the impedance. Called by ``HoldingTorques`` at every step.

A servo on each carriage would hold the object in the hands' base, beside the impedance and stiffer.
So carriages are commanded by torque, and of the palms' errors e_i (6,) from where they were latched
only that counts which no common motion xi of both palms explains:

    w_i = K (e_i - A_i xi),    xi = (sum_i A_i' K A_i)^-1 sum_i A_i' K e_i

with A_i the twist of palm i in a common motion about the object's centre. Then sum_i A_i' w_i = 0:
the springs do not move the object. K is that of the carriages' own servos. Their dampers stay as
they are, stable within a time step; the impedance adds what its own damping is beyond theirs.

``ObjectPath``: where the object should be, from where the carrier should have brought the hands.
Called by ``ObjectImpedance``. The object keeps its pose in the planned base; so its pose, velocity
and acceleration in the world are planned, and a base that sways is made up for by the carriages.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin

from planner.contacts import ContactSet
from planner.errors import TaskError
from planner.spatial import SE3, FloatArray, skew
from planner.task import GraspTask
from sim.controllers.hand_dynamics import HandLoads


def carried_palms(task: GraspTask) -> tuple[int, ...]:
    """Numbers of the contacts that are the palms of two hands, if both take part; none else."""
    palms = [side.palm_body for side in task.hand.pair]
    names = task.finger_names
    return tuple(names.index(p) for p in palms) if palms and set(palms) <= set(names) else ()


def check_two_hands(task: GraspTask) -> None:
    """Refuse what the closed loop cannot command: it needs both palms, or fingertips alone.

    Raises:
        TaskError: The hands are on arms, other links touch, or one palm without the other.
    """
    if task.hand.on_arm:
        raise TaskError(
            f"the closed loop commands two hands on carriages, and {task.hand.name} is on arms; "
            "use the controller feedforward"
        )
    palms = {side.palm_body for side in task.hand.pair}
    touching = [f.name for f in task.fingers if f.name in palms]
    outer = {task.finger_names[i] for i in task.outermost}
    inner = [f.name for f in task.fingers if f.name not in palms and f.name not in outer]
    if inner:
        raise TaskError(
            f"the closed loop commands one contact of each finger, and {', '.join(inner)} touch "
            "too; plan with --type palms, power or fingertip, or use the controller feedforward"
        )
    if len(touching) == 1:
        raise TaskError(
            f"the closed loop takes both palms or none, and {touching[0]} touches alone; plan with "
            "--type palms or fingertip, or use the controller feedforward"
        )


PALM_TORSION = 0.005
"""Torsional friction (m) that a palm is believed to have: (2/3) mu r of a patch of even pressure
with the radius r = 15 mm. Without it only fingers keep the object from turning about the line
between both palms."""


PATCH, TINY = 0.02, 1e-9
"""Radius (m) of what a palm lies on, by which its force may be off its planned point; a torque
(N m) that is none."""


def with_soft_palms(task: GraspTask, contacts: ContactSet) -> ContactSet:
    """Contacts with torsional friction where both palms of two hands lie on the object."""
    palms = carried_palms(task)
    if not palms:
        return contacts
    models, torsion = list(contacts.models), np.array(contacts.mu_torsion)
    for i in palms:
        models[i], torsion[i] = "soft", max(torsion[i], PALM_TORSION)
    forces = np.nan_to_num(contacts.forces)
    return replace(contacts, models=tuple(models), mu_torsion=torsion, forces=forces)


class PalmSprings:
    """Springs between two palms that are moved by torque.

    Attributes:
        palms: Numbers of the contacts that are the palms.
    """

    def __init__(self, task: GraspTask) -> None:
        """Take stiffness and damping of the carriages' servos."""
        self.palms = carried_palms(task)
        fingers = [task.fingers[i] for i in self.palms]
        self._joints = [f.pad.joint_id for f in fingers]
        self._index = [f.q_index for f in fingers]
        actuation = task.hand.actuation
        gains = -actuation.bias[:, 1:].T @ actuation.moment**2  # (2, nq)
        both = np.mean([gains[:, k] for k in self._index], axis=0)  # (2, 6)
        self._gains = np.repeat(both.reshape(2, 2, 3).mean(axis=2), 3, axis=1)
        self._poses = [SE3.Identity() for _ in fingers]
        self._latched = [SE3.Identity() for _ in fingers]
        self._nq = task.hand.nq
        self._jacobians = np.zeros((len(fingers), 6, self._nq))

    def move(self, loads: HandLoads) -> None:
        """Go to where the hand is now."""
        for i, (joint, k) in enumerate(zip(self._joints, self._index, strict=True)):
            pose = loads.pose(joint)
            self._poses[i] = pose
            own = loads.jacobian[:, k]
            self._jacobians[i][:, k] = own
            self._jacobians[i][:3, k] -= skew(pose.translation) @ own[3:]

    def latch(self) -> None:
        """Keep the palms to each other as they are now."""
        self._latched = list(self._poses)

    def moment(self, missed: FloatArray, pressed: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Joint torques (nq,) by which the palms exert a torque that no contact points give.

        A palm that lies on the object turns it by how its pressure is spread. Each gives half, as
        far as its force reaches: ``PATCH`` times that.

        Args:
            missed: Torque on the object (3,), N m, base axes.
            pressed: Normal forces (2,) of the palms, N.

        Returns:
            The joint torques, and the torque on the object that they exert (3,), N m.
        """
        half = missed / len(self._joints)
        size = max(float(np.linalg.norm(half)), TINY)
        shares = np.minimum(1.0, PATCH * pressed / size)
        exerted = shares[:, None] * half
        torque = exerted.ravel() @ self._jacobians[:, 3:].reshape(-1, self._nq)
        return np.asarray(torque), exerted.sum(axis=0)

    def pull(self, center: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Of the springs the joint torques (nq,), N m; of the dampers the wrench on the object.

        Args:
            center: Of the object (3,), m.
            v: Rates of the joints (nq,).

        Returns:
            The torques; the palms' common twist (6,), m/s and rad/s; and by what the servos'
            dampers brake it (6,), N and N m, about the centre.
        """
        arms = np.array([pose.translation for pose in self._poses]) - center
        common = np.tile(np.eye(6), (len(arms), 1, 1))
        common[:, :3, 3:] = -skew(arms)
        errors = [
            [*(kept.translation - now.translation), *pin.log3(kept.rotation @ now.rotation.T)]
            for kept, now in zip(self._latched, self._poses, strict=True)
        ]
        stiffness, damping = self._gains
        spring, _ = _apart(common, np.array(errors), stiffness)
        motions = self._jacobians @ v
        _, twist = _apart(common, motions, damping)
        torque = np.einsum("iwj,iw->j", self._jacobians, stiffness * spring)
        brake = -np.einsum("iwj,iw->j", common, damping * motions)
        return torque, twist, brake


def _apart(
    common: FloatArray, motions: FloatArray, gains: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """What motions (n, 6) have beyond a common one, and that (6,), weighted by gains (6,)."""
    weighted = common.transpose(0, 2, 1) * gains
    shared = np.linalg.solve(
        (weighted @ common).sum(axis=0), (weighted @ motions[:, :, None]).sum(axis=0)[:, 0]
    )
    return motions - common @ shared, shared


class ObjectPath:
    """Planned pose, velocity and acceleration of an object between two hands.

    Attributes:
        T_base_wanted: Where it should be, in the base where that is now.
        twist: (6,), its velocity relative to the base, m/s and rad/s, base axes.
        acceleration: (3,), of its centre, m/s2, base axes.
        inertial: (6,), wrench that accelerates it so, N and N m, about its centre, base axes.
    """

    def __init__(self, task: GraspTask, mass: float) -> None:
        """Nothing moves yet.

        Args:
            task: What is carried.
            mass: Of the object, as it is believed, kg.
        """
        self._mass = mass
        self._inertia = task.object.shape.inertia(mass)
        self._last: tuple[SE3, SE3] | None = None
        self._velocity: FloatArray | None = None
        self.T_base_wanted = SE3.Identity()
        self.twist, self.inertial = np.zeros((2, 6))
        self.acceleration = np.zeros(3)

    def follow(
        self, elapsed: float, T_base_object: SE3, T_world_base: SE3, T_world_planned: SE3 | None
    ) -> None:
        """Go on to a time step.

        Args:
            elapsed: Since the last one, s.
            T_base_object: Pose of the object that is kept in the planned base.
            T_world_base: Where the base is.
            T_world_planned: Where it should be; where it is if None.
        """
        planned = T_world_base if T_world_planned is None else T_world_planned
        wanted = planned * T_base_object
        turn = np.asarray(T_world_base.rotation.T)
        self.T_base_wanted = T_world_base.inverse() * wanted
        held = T_world_base * self.T_base_wanted  # = wanted, carried on by the base as it is
        last, self._last = self._last, (wanted, T_world_base)
        if last is None or elapsed <= 0.0:
            return
        velocity = _velocity(last[0], wanted, elapsed)
        moved = last[1] * T_world_base.inverse() * held
        drift = _velocity(moved, held, elapsed)
        before, self._velocity = self._velocity, velocity
        self.twist = _turned(turn, velocity - drift)
        if before is None:
            return
        change = (velocity - before) / elapsed
        spin = velocity[3:]
        inertia = wanted.rotation @ self._inertia @ wanted.rotation.T
        torque = inertia @ change[3:] + np.cross(spin, inertia @ spin)
        self.acceleration = turn @ change[:3]
        self.inertial = _turned(turn, np.concatenate([self._mass * change[:3], torque]))


def _velocity(before: SE3, after: SE3, elapsed: float) -> FloatArray:
    """Velocity (6,) of an origin and of a frame's axes between two poses, world axes."""
    turned = pin.log3(after.rotation @ before.rotation.T)
    return np.concatenate([after.translation - before.translation, turned]) / elapsed


def _turned(turn: FloatArray, both: FloatArray) -> FloatArray:
    """Two vectors (6,) in turned axes."""
    return np.asarray((both.reshape(2, 3) @ turn.T).ravel())
