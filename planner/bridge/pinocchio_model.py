"""A compiled MuJoCo model as a Pinocchio model, exactly, and rows over its joints.

Pinocchio's own MJCF reader loses the root pose, limits, masses and more; this conversion reads the
compiled ``MjModel``, where all of MuJoCo's defaults are already applied. Joints keep MuJoCo's order
(depth first), so for hinge and slide joints Pinocchio's q and v are MuJoCo's qpos and qvel. A free
or a ball joint differs: quaternions are w, x, y, z in MuJoCo and x, y, z, w in Pinocchio, and the
linear velocity of a free joint is in world axes in MuJoCo, in body axes in Pinocchio.

Rows are the same at every q: moment arms of actuators, coefficients of fixed tendons, and the
couplings C q = d that the model holds by itself. Equalities between joints (URDF ``mimic`` becomes
one) and between fixed tendons hold

    x1 - x1_0 = c0 + c1 (x2 - x2_0),

x a joint position or a tendon length and x_0 its value at ``qpos0`` (MuJoCo documentation, XML
reference, ``equality/joint``); without a second part, x1 - x1_0 = c0.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin

from planner.errors import ModelError
from planner.joints.couplings import Coupling
from planner.spatial import SE3, FloatArray, pose_from_wxyz

_AXES = {int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)}
_JOINTS = {int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT)}
_TENDON = int(mujoco.mjtTrn.mjTRN_TENDON)
_WRAP_JOINT = int(mujoco.mjtWrap.mjWRAP_JOINT)
_EQ_JOINT = int(mujoco.mjtEq.mjEQ_JOINT)
_EQ_CONNECT, _EQ_WELD = int(mujoco.mjtEq.mjEQ_CONNECT), int(mujoco.mjtEq.mjEQ_WELD)
_SITE = int(mujoco.mjtObj.mjOBJ_SITE)
_EQ_TENDON = int(mujoco.mjtEq.mjEQ_TENDON)


def actuator_row(model: Any, actuator: int) -> FloatArray | None:
    """Moment arms (nv,) of an actuator, m/rad or -: joint torque = row * its force.

    Of gears on hinges and slides (in the parent's axes or the child's: the same for one axis) and
    of fixed tendons. None if the arms depend on q.
    """
    kind, target = int(model.actuator_trntype[actuator]), int(model.actuator_trnid[actuator, 0])
    gear = float(model.actuator_gear[actuator, 0])
    if kind in _JOINTS and int(model.jnt_type[target]) in _AXES:
        row = np.zeros(model.nv)
        row[int(model.jnt_dofadr[target])] = gear
        return row
    if kind == _TENDON and is_fixed_tendon(model, target):
        return gear * tendon_row(model, target)
    return None


def is_fixed_tendon(model: Any, tendon: int) -> bool:
    """Whether a tendon is a sum over joints, and does not run through space."""
    start, count = int(model.tendon_adr[tendon]), int(model.tendon_num[tendon])
    return all(int(kind) == _WRAP_JOINT for kind in model.wrap_type[start : start + count])


def tendon_row(model: Any, tendon: int) -> FloatArray:
    """Coefficients (nv,) of a fixed tendon: length = row @ q.

    Raises:
        ModelError: The tendon runs through space.
    """
    if not is_fixed_tendon(model, tendon):
        name = model.tendon(tendon).name
        raise ModelError(
            f"tendon {name!r} runs through space; only fixed tendons, which are linear in the "
            f"joints, are read: write drop_couplings = [{name!r}] under [repair] if the hand "
            "works without it"
        )
    row = np.zeros(model.nv)
    start = int(model.tendon_adr[tendon])
    for w in range(start, start + int(model.tendon_num[tendon])):
        row[int(model.jnt_dofadr[int(model.wrap_objid[w])])] += float(model.wrap_prm[w])
    return row


def couplings_from_mujoco(model: Any) -> tuple[Coupling, ...]:
    """Every active equality of a model of hinges and slides, in the model's order.

    Raises:
        ModelError: An equality is not linear in the joints, or ties bodies instead of joints.
    """
    out = []
    for i in range(model.neq):
        if not model.eq_active0[i]:
            continue
        name, kind = model.equality(i).name, int(model.eq_type[i])
        if kind not in (_EQ_JOINT, _EQ_TENDON):
            tied = tied_bodies(model, i)
            if tied is not None and len(links_of(model, tied)) == 1:
                continue
            raise ModelError(
                f"equality {name!r} closes a loop between bodies, and only couplings of joints and "
                "fixed tendons are read; replace it by a <joint> or <tendon> equality, or write "
                f"drop_couplings = [{name!r}] under [repair]"
            )
        first, second = int(model.eq_obj1id[i]), int(model.eq_obj2id[i])
        row, value = _part(model, kind, first)
        constant, slope, *higher = (float(c) for c in model.eq_data[i, :5])
        value += constant
        if second >= 0:
            if any(higher):
                raise ModelError(
                    f"equality {name!r} has polycoef {[constant, slope, *higher]}, which is not "
                    "linear; only the first two coefficients may differ from 0"
                )
            other, other_value = _part(model, kind, second)
            row, value = row - slope * other, value - slope * other_value
        out.append(Coupling(name=name, row=row, value=value, one_sided=False))
    return tuple(out)


def tied_bodies(model: Any, equality: int) -> tuple[int, int] | None:
    """The two bodies that an equality ties, at points or as a whole; None if it ties no bodies."""
    if int(model.eq_type[equality]) not in (_EQ_CONNECT, _EQ_WELD):
        return None
    first, second = int(model.eq_obj1id[equality]), int(model.eq_obj2id[equality])
    if int(model.eq_objtype[equality]) == _SITE:
        return int(model.site_bodyid[first]), int(model.site_bodyid[second])
    return first, second


def links_of(model: Any, tied: tuple[int, int]) -> set[int]:
    """The links that two bodies are parts of: one where no joint is between them; 0 is the world.

    Bodies of one link are tied already: another tie between them closes no loop.
    """
    return {int(model.body_weldid[body]) for body in tied}


def _part(model: Any, kind: int, number: int) -> tuple[FloatArray, float]:
    """Row (nv,) of a joint or tendon, and its value at ``qpos0``."""
    if kind == _EQ_TENDON:
        return tendon_row(model, number), float(model.tendon_length0[number])
    row = np.zeros(model.nv)
    row[int(model.jnt_dofadr[number])] = 1.0
    return row, float(model.qpos0[int(model.jnt_qposadr[number])])


_HINGE, _SLIDE, _BALL, _FREE = (
    int(t)
    for t in (
        mujoco.mjtJoint.mjJNT_HINGE,
        mujoco.mjtJoint.mjJNT_SLIDE,
        mujoco.mjtJoint.mjJNT_BALL,
        mujoco.mjtJoint.mjJNT_FREE,
    )
)
_SAME_AS_BODY, _SAME_AS_INERTIA, _TURNED_AS_BODY, _TURNED_AS_INERTIA = (
    int(t)
    for t in (
        mujoco.mjtSameFrame.mjSAMEFRAME_BODY,
        mujoco.mjtSameFrame.mjSAMEFRAME_INERTIA,
        mujoco.mjtSameFrame.mjSAMEFRAME_BODYROT,
        mujoco.mjtSameFrame.mjSAMEFRAME_INERTIAROT,
    )
)


def pinocchio_from_mujoco(model: Any) -> Any:
    """Build a ``pinocchio.Model`` with the kinematics and inertia of a compiled ``MjModel``.

    Every body and every site becomes a frame of the same name (BODY and OP_FRAME); armature,
    linear damping, dry friction, position limits and gravity are copied. A part without a name is
    called by its kind and number, as ``body_3``. Bodies without joints, mocap bodies among them,
    stand where they are drawn. Effort limits are those of ``effort_limits``, a bound: the torque
    that is possible at one q may be smaller, see ``planner.joints.actuation``.

    Left out, since ``pinocchio.Model`` has no place for it: springs, damping that is a polynomial,
    gravity compensation, fluid forces, armature of tendons, couplings.

    Args:
        model: ``mujoco.MjModel``.
    """
    out = pin.Model()
    out.name = "hand"
    out.gravity = pin.Motion(np.concatenate([model.opt.gravity, np.zeros(3)]))
    parent_joint = np.zeros(model.nbody, dtype=int)  # Pinocchio joint that carries each body
    in_joint: list[SE3] = [SE3.Identity() for _ in range(model.nbody)]  # body pose in that joint
    body_frame = np.zeros(model.nbody, dtype=int)
    for body in range(1, model.nbody):
        up = int(model.body_parentid[body])
        joint = int(parent_joint[up])
        pose = in_joint[up] * pose_from_wxyz(model.body_pos[body], model.body_quat[body])
        first = int(model.body_jntadr[body])
        for j in range(first, first + int(model.body_jntnum[body])):
            joint = _add_joint(out, model, j, joint, pose)
            is_free = int(model.jnt_type[j]) == _FREE
            pose = SE3.Identity() if is_free else SE3(np.eye(3), -np.array(model.jnt_pos[j]))
        parent_joint[body], in_joint[body] = joint, pose
        if model.body_mass[body] > 0 or model.body_inertia[body].any():
            principal = _inertial_pose(model, body)
            turn = principal.rotation
            inertia = turn @ np.diag(model.body_inertia[body]) @ turn.T
            out.appendBodyToJoint(
                joint,
                pin.Inertia(float(model.body_mass[body]), principal.translation, inertia),
                pose,
            )
        body_frame[body] = out.addFrame(
            pin.Frame(body_name(model, body), joint, pose, pin.FrameType.BODY),
            False,
        )
    for s in range(model.nsite):
        body = int(model.site_bodyid[s])
        local = pose_from_wxyz(model.site_pos[s], model.site_quat[s])
        inertial = _inertial_pose(model, body)
        pose = in_joint[body] * _snapped(local, inertial, int(model.site_sameframe[s]))
        name = site_name(model, s)
        out.addFrame(pin.Frame(name, int(parent_joint[body]), pose, pin.FrameType.OP_FRAME), False)
    out.armature = np.array(model.dof_armature)
    out.damping = np.array(model.dof_damping)
    out.lowerDryFrictionLimit = -np.array(model.dof_frictionloss)
    out.upperDryFrictionLimit = np.array(model.dof_frictionloss)
    out.lowerEffortLimit, out.upperEffortLimit = effort_limits(model).T
    return out


def _inertial_pose(model: Any, body: int) -> SE3:
    """Pose of a body's principal axes of inertia in the body's frame."""
    pose = pose_from_wxyz(model.body_ipos[body], model.body_iquat[body])
    return _snapped(pose, pose, int(model.body_sameframe[body]))


def _snapped(pose: SE3, inertial: SE3, same: int) -> SE3:
    """A pose in a body as MuJoCo uses it.

    What is within 1e-6 of the body's frame, or of its inertial frame, MuJoCo takes to be there
    (``mjtSameFrame``; found in the compiled model, not in its documentation).
    """
    if same == _SAME_AS_BODY:
        return SE3.Identity()
    if same == _SAME_AS_INERTIA:
        return inertial
    if same == _TURNED_AS_BODY:
        return SE3(np.eye(3), pose.translation)
    if same == _TURNED_AS_INERTIA:
        return SE3(inertial.rotation, pose.translation)
    return pose


def body_name(model: Any, body: int) -> str:
    """Name of a body; a body without one is called by its number."""
    return _name(model.body, "body", body, model.nbody)


def joint_name(model: Any, joint: int) -> str:
    """Name of a joint; a joint without one is called by its number."""
    return _name(model.joint, "joint", joint, model.njnt)


def site_name(model: Any, site: int) -> str:
    """Name of a site; a site without one is called by its number."""
    return _name(model.site, "site", site, model.nsite)


def _name(part: Callable[[int], Any], kind: str, number: int, count: int) -> str:
    """Of a part, or ``kind_number``, with underscores behind it until no other is called so."""
    if named := str(part(number).name):
        return named
    taken = {part(i).name for i in range(count)}
    out = f"{kind}_{number}"
    while out in taken:
        out += "_"
    return out


def effort_limits(model: Any) -> FloatArray:
    """Bounds (nv, 2) in N m or N of what all actuators together give each joint.

    The sum over actuators of force range times moment, for gears and fixed tendons, within the
    joint's own ``actuatorfrcrange``. Infinite where an actuator without force range or with a
    moment that depends on q acts, and where no actuator acts.
    """
    out = np.zeros((model.nv, 2))
    for i in range(model.nu):
        row = actuator_row(model, i)
        if row is None:  # any joint, by any torque
            row = np.full(model.nv, np.inf)
        for dof in np.flatnonzero(row):
            if model.actuator_forcelimited[i] and np.isfinite(row[dof]):
                out[dof] += np.sort(row[dof] * model.actuator_forcerange[i])
            else:
                out[dof] += [-np.inf, np.inf]
    idle = ~out.any(axis=1)
    out[idle] = [-np.inf, np.inf]
    for j in np.flatnonzero(model.jnt_actfrclimited):
        at = int(model.jnt_dofadr[j])
        out[at] = np.clip(out[at], *model.jnt_actfrcrange[j])
    return out


def _add_joint(out: Any, model: Any, j: int, parent: int, pose: SE3) -> int:
    """Append MuJoCo joint j below Pinocchio joint ``parent``; ``pose`` is the body's pose there."""
    name = joint_name(model, j)
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
