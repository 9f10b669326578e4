"""The gantry that a hand without an arm hangs on: six driven joints, and what drives them.

All six read zero at the planned base pose: three slides along the world's axes, then three hinges
about axes of choice, the world's by default, so that

    T_world_base = Trans(p0 + [x, y, z]) B Rx(rx) Ry(ry) Rz(rz) B' R0,

with the hinges' axes in the columns of B. The first hinge turns by any angle without a singularity.

The servos carry the hand's weight by feed-forward, so that it does not sag.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin

from planner.bridge.numbers import LEAST_INERTIA, LEAST_MASS
from planner.spatial import SE3, FloatArray, IntArray

__all__ = [
    "GANTRY",
    "GANTRY_AXES",
    "GANTRY_FREQUENCY",
    "GANTRY_INERTIA",
    "GANTRY_MASS",
    "Gantry",
    "add_gantry",
    "tuned_gantry",
]

GANTRY = "gantry"
"""Name of the gantry's body; its joints and servos are ``gantry_x`` and so on."""

GANTRY_AXES = ("x", "y", "z", "rx", "ry", "rz")
"""The gantry's joints, in order."""

GANTRY_FREQUENCY = 60.0
"""Undamped natural frequency of each gantry axis under the mass it carries, rad/s: an arm of about
10 Hz, which a payload of 0.1 kg lets sag by less than 0.3 mm."""

GANTRY_DAMPING = 1.0
"""Damping ratio of each gantry axis (-): no overshoot."""

GANTRY_MASS = LEAST_MASS
"""Mass of a gantry to which nothing with a mass is fixed, kg: MuJoCo refuses to move a body without
one. It counts as none, as that of a link does which only joins two joints."""

GANTRY_INERTIA = LEAST_INERTIA
"""Its moment of inertia about every axis, kg m^2. MuJoCo's own limit of 1e-15 would not do: where
the wrist has no armature, turning the gantry against the wrist would meet no inertia but this."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Gantry:
    """The gantry in a compiled model; rows in the order of ``GANTRY_AXES``.

    Attributes:
        T_world_base: Base pose at which all joints read zero.
        qpos: (6,), its joints in ``data.qpos``.
        dof: (6,), the same in ``data.qvel``.
        ctrl: (6,), its servos in ``data.ctrl``.
        gains: (2, 6), stiffness (N/m, N m/rad) and damping of the servos.
        hinges: (3, 3), axes of the hinges in its columns, world.
    """

    T_world_base: SE3
    qpos: IntArray
    dof: IntArray
    ctrl: IntArray
    gains: FloatArray
    hinges: FloatArray = field(default_factory=lambda: np.eye(3))

    def coordinates(self, T_world_base: SE3) -> FloatArray:
        """Joints (6,), m and rad, that put the hand's base at a pose.

        The second hinge cannot turn by 90 degrees away from the grasp.
        """
        turn = T_world_base.rotation @ self.T_world_base.rotation.T
        turn = self.hinges.T @ turn @ self.hinges
        ry = np.arcsin(np.clip(turn[0, 2], -1.0, 1.0))
        rx = np.arctan2(-turn[1, 2], turn[2, 2])
        rz = np.arctan2(-turn[0, 1], turn[0, 0])
        shift = T_world_base.translation - self.T_world_base.translation
        return np.concatenate([shift, [rx, ry, rz]])

    def pose(self, coordinates: FloatArray) -> SE3:
        """Pose of the hand's base for joints (6,), m and rad: the inverse of ``coordinates``."""
        turn = self.T_world_base.rotation
        for angle, axis in zip(coordinates[:2:-1], self.hinges.T[::-1], strict=True):  # Rx Ry Rz R0
            turn = pin.exp3(float(angle) * axis) @ turn
        return SE3(turn, self.T_world_base.translation + coordinates[:3])

    def command(self, data: Any, target: FloatArray, velocity: FloatArray) -> FloatArray:
        """Servo commands (6,) that move the gantry.

        The servos' law is F = kp (ctrl - q) - kd v. The command adds what makes the gantry follow
        without lag, kd velocity, and what carries the hand, MuJoCo's bias force.

        Args:
            data: ``mujoco.MjData``.
            target: Joints (6,), m and rad.
            velocity: Their rates (6,), per second.
        """
        kp, kd = self.gains
        forward = kd * velocity + data.qfrc_bias.take(self.dof)
        return np.asarray(target + forward / kp)


def add_gantry(spec: Any, body: Any, hand_model: Any, hinges: FloatArray) -> None:
    """Give a body of a ``mujoco.MjSpec`` the joints and servos, and a mass if it carries none.

    Args:
        spec: The scene; changed.
        body: Stands where the base is; the hand is attached to it.
        hand_model: ``mujoco.MjModel`` of the hand alone.
        hinges: (3, 3), axes of the hinges in its columns, world.
    """
    axes = np.vstack([np.eye(3), hinges.T])
    if not _fixed_mass(hand_model):
        body.explicitinertial = True
        body.mass, body.inertia = GANTRY_MASS, np.full(3, GANTRY_INERTIA)
    for k, axis in enumerate(GANTRY_AXES):
        name = f"{GANTRY}_{axis}"
        kind = mujoco.mjtJoint.mjJNT_SLIDE if k < 3 else mujoco.mjtJoint.mjJNT_HINGE
        body.add_joint(name=name, type=kind, axis=axes[k])
        servo = spec.add_actuator(name=name, target=name)
        servo.trntype = mujoco.mjtTrn.mjTRN_JOINT
        servo.gaintype = mujoco.mjtGain.mjGAIN_FIXED
        servo.biastype = mujoco.mjtBias.mjBIAS_AFFINE


def _fixed_mass(hand_model: Any) -> bool:
    """Whether a body that no joint of the hand moves has the mass and inertia MuJoCo asks for."""
    fixed = hand_model.body_weldid == 0
    least = np.minimum(hand_model.body_mass, hand_model.body_inertia.min(axis=1))
    return bool((least[fixed] >= mujoco.mjMINVAL).any())


def tuned_gantry(
    model: Any, T_world_base: SE3, payload: float, payload_body: str, hinges: FloatArray
) -> Gantry:
    """Set the servos' gains in a compiled model, from the inertia that each axis carries.

    Args:
        model: ``mujoco.MjModel``; changed.
        T_world_base: Base pose at which the joints read zero.
        payload: Mass that will be carried, kg.
        payload_body: Name of its body.
        hinges: (3, 3), axes of the hinges in its columns, world.
    """
    names = [f"{GANTRY}_{axis}" for axis in GANTRY_AXES]
    dof = np.array([int(model.joint(name).dofadr[0]) for name in names])
    ctrl = np.array([int(model.actuator(name).id) for name in names])
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    mass_matrix = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass_matrix)
    arm = hinges.T @ (data.body(payload_body).xpos - data.body(GANTRY).xpos)
    lever2 = arm @ arm - arm**2
    carried = np.diag(mass_matrix)[dof] + payload * np.concatenate([np.ones(3), lever2])
    kp = carried * GANTRY_FREQUENCY**2
    kd = 2.0 * GANTRY_DAMPING * GANTRY_FREQUENCY * carried
    model.actuator_gainprm[ctrl, 0] = kp
    model.actuator_biasprm[ctrl, 1] = -kp
    model.actuator_biasprm[ctrl, 2] = -kd
    return Gantry(
        T_world_base=T_world_base,
        qpos=np.array([int(model.joint(name).qposadr[0]) for name in names]),
        dof=dof,
        ctrl=ctrl,
        gains=np.array([kp, kd]),
        hinges=hinges,
    )
