"""A compiled MuJoCo model as a Pinocchio model, exactly.

Pinocchio's own MJCF reader loses the root pose, limits, masses and more; this conversion reads the
compiled ``MjModel``, where all of MuJoCo's defaults are already applied. Joints keep MuJoCo's order
(depth first), so for hinge and slide joints Pinocchio's q and v are MuJoCo's qpos and qvel.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pinocchio as pin

from planner.errors import ModelError
from planner.spatial import SE3, FloatArray, pose_from_wxyz

__all__ = ["body_name", "pinocchio_from_mujoco"]

_HINGE, _SLIDE, _BALL, _FREE = (
    int(t)
    for t in (
        mujoco.mjtJoint.mjJNT_HINGE,
        mujoco.mjtJoint.mjJNT_SLIDE,
        mujoco.mjtJoint.mjJNT_BALL,
        mujoco.mjtJoint.mjJNT_FREE,
    )
)


def pinocchio_from_mujoco(model: Any) -> Any:
    """Build a ``pinocchio.Model`` with the kinematics and inertia of a compiled ``MjModel``.

    Every body and every site becomes a frame of the same name (BODY and OP_FRAME); ``armature``,
    position limits and gravity are copied. Effort limits stay infinite: which joint torques are
    possible depends on the actuators and on q, see ``planner.actuation``.

    Args:
        model: ``mujoco.MjModel``; every joint needs a name.

    Raises:
        ModelError: A joint has no name.
    """
    out = pin.Model()
    out.name = "hand"
    out.gravity = pin.Motion(np.concatenate([model.opt.gravity, np.zeros(3)]))
    parent_joint = np.zeros(model.nbody, dtype=int)  # Pinocchio joint that carries each body
    in_joint: list[SE3] = [SE3.Identity() for _ in range(model.nbody)]  # body pose in that joint
    body_frame = np.zeros(model.nbody, dtype=int)
    armature: list[FloatArray] = []
    for body in range(1, model.nbody):
        up = int(model.body_parentid[body])
        joint = int(parent_joint[up])
        pose = in_joint[up] * pose_from_wxyz(model.body_pos[body], model.body_quat[body])
        first = int(model.body_jntadr[body])
        for j in range(first, first + int(model.body_jntnum[body])):
            joint = _add_joint(out, model, j, joint, pose)
            address, size = int(model.jnt_dofadr[j]), out.joints[joint].nv
            armature.append(np.array(model.dof_armature[address : address + size]))
            is_free = int(model.jnt_type[j]) == _FREE
            pose = SE3.Identity() if is_free else SE3(np.eye(3), -np.array(model.jnt_pos[j]))
        parent_joint[body], in_joint[body] = joint, pose
        if model.body_mass[body] > 0:
            turn = pose_from_wxyz(np.zeros(3), model.body_iquat[body]).rotation
            inertia = turn @ np.diag(model.body_inertia[body]) @ turn.T
            out.appendBodyToJoint(
                joint,
                pin.Inertia(float(model.body_mass[body]), np.array(model.body_ipos[body]), inertia),
                pose,
            )
        body_frame[body] = out.addFrame(
            pin.Frame(body_name(model, body), joint, pose, pin.FrameType.BODY),
            False,
        )
    for s in range(model.nsite):
        body = int(model.site_bodyid[s])
        pose = in_joint[body] * pose_from_wxyz(model.site_pos[s], model.site_quat[s])
        name = model.site(s).name or f"site_{s}"
        out.addFrame(pin.Frame(name, int(parent_joint[body]), pose, pin.FrameType.OP_FRAME), False)
    out.armature = np.concatenate(armature) if armature else np.zeros(0)
    return out


def body_name(model: Any, body: int) -> str:
    """Name of a body; a body without one is called by its number."""
    return model.body(body).name or f"body_{body}"


def _add_joint(out: Any, model: Any, j: int, parent: int, pose: SE3) -> int:
    """Append MuJoCo joint j below Pinocchio joint ``parent``; ``pose`` is the body's pose there."""
    name = model.joint(j).name
    if not name:
        raise ModelError(f"joint number {j} of the model has no name; name every joint")
    kind = int(model.jnt_type[j])
    axis, anchor = np.array(model.jnt_axis[j]), np.array(model.jnt_pos[j])
    placement = pose * SE3(np.eye(3), anchor)
    reference = float(model.qpos0[int(model.jnt_qposadr[j])])
    if kind == _HINGE:
        joint = pin.JointModelRevoluteUnaligned(axis)
        # MuJoCo measures the angle from qpos0, where the body stands as it is drawn.
        placement = placement * SE3(pin.exp3(-reference * axis), np.zeros(3))
    elif kind == _SLIDE:
        joint = pin.JointModelPrismaticUnaligned(axis)
        placement = placement * SE3(np.eye(3), -reference * axis)
    elif kind == _BALL:
        joint = pin.JointModelSpherical()
    else:
        joint, placement = pin.JointModelFreeFlyer(), SE3.Identity()
    unlimited = np.full(joint.nq, np.inf)
    lower, upper = -unlimited, unlimited
    if kind in (_HINGE, _SLIDE) and model.jnt_limited[j]:
        lower, upper = model.jnt_range[j, :1].copy(), model.jnt_range[j, 1:].copy()
    infinite = np.full(joint.nv, np.inf)
    return int(out.addJoint(parent, joint, placement, name, infinite, infinite, lower, upper))
