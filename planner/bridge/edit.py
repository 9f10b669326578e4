"""Other hands from a model: mirror image, hand on an arm, two hands, a motor on every joint.

**Mirror.** With M = diag(signs) the reflection through a coordinate plane, every frame of the model
goes to the frame that the mirror shows, conjugated so that it stays right-handed: position p ->
M p, rotation R -> M R M, with the same M in the coordinates of every body. A pose T of a body in
any other then becomes M T M, at the same joint positions. An axis of rotation is an axial vector,
a -> -M a; a direction of sliding is a polar one, a -> M a. Names, joint ranges, actuators, tendons,
masses and materials stay. M is a coordinate reflection, because each primitive and each principal
inertia is symmetric about the coordinate planes of its own frame; so M R M places its mirror image,
and nothing is rounded.

**Arm.** Two ``mujoco.MjSpec`` become one. The arm's names get the prefix ``arm/``; the hand's stay,
so that its description holds for the whole.

**Two hands.** Each hangs on a carriage of driven joints under one root body; names get prefixes.

**Motors.** A motor's torque is its command, within what the actuators of the model can make at that
joint: the sum over them of the moment arm times the force range. A tendon over two joints becomes a
motor on each, and tied joints keep their own as well: torque at the joint itself need not pass
through a tie, which yields a little (``planner.bridge.load.RIGID_SOLREF``). Equalities stay, with
the tendons that they hold. All other tendons go, with their stops and springs; a stop that must
remain is described as a coupling.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from planner.bridge.actuation import actuation_from_mujoco
from planner.bridge.load import HIDDEN_GROUP, compile_spec
from planner.bridge.prepare import delete_joints, isolate_base, name_parts
from planner.errors import HandError, ModelError, NotFoundError
from planner.spatial import SE3, FloatArray, pose_from_wxyz, pose_to_wxyz

_SYMMETRIC = {
    int(mujoco.mjtGeom.mjGEOM_SPHERE),
    int(mujoco.mjtGeom.mjGEOM_CAPSULE),
    int(mujoco.mjtGeom.mjGEOM_CYLINDER),
    int(mujoco.mjtGeom.mjGEOM_BOX),
    int(mujoco.mjtGeom.mjGEOM_ELLIPSOID),
}
_PLACED_EQUALITIES = {
    int(mujoco.mjtEq.mjEQ_CONNECT),
    int(mujoco.mjtEq.mjEQ_WELD),
}
_HINGE = int(mujoco.mjtJoint.mjJNT_HINGE)
_QUATERNION = mujoco.mjtOrientation.mjORIENTATION_QUAT
_IDENTITY = (1.0, 0.0, 0.0, 0.0)


def mirror_spec(spec: Any, signs: FloatArray, what: str) -> None:
    """Reflect a ``mujoco.MjSpec`` of hinges and slides, in place.

    A spec can hold a pose in many ways (Euler angles, end points, nested frames, inertia from
    geometry). It is therefore compiled first, and the compiled poses are written back, reflected.
    Cameras and lights are removed: a scene brings its own. So are meshes that are only shown; what
    collides is drawn in their place.

    Args:
        spec: The model; afterwards its mirror image, ready to be compiled or attached.
        signs: Diagonal of M, (3,): one -1 for the normal of the mirror plane, two +1.
        what: What is being mirrored, for messages.

    Raises:
        ModelError: MuJoCo refuses the model.
        HandError: The model has a part whose mirror image is not supported: a mesh, a plane or a
            height field, or an equality that ties two bodies at given points.
    """
    for geom in [g for g in spec.geoms if g.meshname and _is_only_shown(g)]:
        for other in geom.parent.geoms:
            other.group = 0 if other.group == HIDDEN_GROUP else other.group
        spec.delete(geom)
    model = compile_spec(spec, what)
    _check(spec, what)
    for element in (*spec.cameras, *spec.lights):
        spec.delete(element)
    turn = np.array([1.0, *-signs])  # of a quaternion w, x, y, z under R -> M R M
    for frame in spec.frames:  # the compiled poses below include them
        frame.pos, frame.quat, frame.alt.type = np.zeros(3), _IDENTITY, _QUATERNION
    for body in spec.bodies[1:]:
        i = body.id
        _place(body, signs * model.body_pos[i], turn * model.body_quat[i])
        if model.body_mass[i] > 0:  # as compiled: not to be derived or scaled once more
            body.explicitinertial = True
            body.mass, body.inertia = model.body_mass[i], model.body_inertia[i]
            body.fullinertia = np.full(6, np.nan)
            body.ipos, body.iquat = signs * model.body_ipos[i], turn * model.body_iquat[i]
            body.ialt.type = _QUATERNION
    for geom in spec.geoms:
        i = geom.id
        _place(geom, signs * model.geom_pos[i], turn * model.geom_quat[i])
        geom.fromto, geom.size = np.full(6, np.nan), model.geom_size[i]
    for site in spec.sites:
        i = site.id
        _place(site, signs * model.site_pos[i], turn * model.site_quat[i])
        site.fromto, site.size = np.full(6, np.nan), model.site_size[i]
    for joint in spec.joints:
        i = joint.id
        polar = -1.0 if int(model.jnt_type[i]) == _HINGE else 1.0
        joint.pos, joint.axis = signs * model.jnt_pos[i], polar * signs * model.jnt_axis[i]


def _is_only_shown(geom: Any) -> bool:
    return not (geom.contype or geom.conaffinity) and 0.0 in (geom.density, geom.mass)


def _place(element: Any, position: FloatArray, quaternion: FloatArray) -> None:
    """Set a pose as position and quaternion; the other ways to give an orientation are dropped."""
    element.pos, element.quat, element.alt.type = position, quaternion, _QUATERNION


def _check(spec: Any, what: str) -> None:
    for element in (*spec.geoms, *spec.sites):
        if int(element.type) not in _SYMMETRIC or element.meshname:
            raise HandError(
                f"{what}: {element.name or 'a geom without name'!r} is a mesh, a plane or a height "
                "field, and mirroring a mesh is not supported; use spheres, capsules, cylinders, "
                "boxes or ellipsoids, or give the other hand a model of its own"
            )
    for equality in spec.equalities:
        if int(equality.type) in _PLACED_EQUALITIES:
            raise HandError(
                f"{what}: equality {equality.name!r} ties two bodies at points, and mirroring that "
                "is not supported; couple joints or tendons, or give the other hand a model of its "
                "own"
            )


ARM_PREFIX = "arm/"
"""Prefix of every name of the arm's model in a hand that it carries."""


def mount_spec(arm: Any, hand: Any, *, site: str, T_site_base: SE3, what: str) -> tuple[Any, str]:
    """A spec of an arm that carries a hand, and the name of its root body.

    Args:
        arm: ``mujoco.MjSpec`` of the arm, with one root body.
        hand: ``mujoco.MjSpec`` of the hand; attached, so give a fresh one.
        site: Site of the arm that the hand is put on.
        T_site_base: Where the hand's base is in that site.
        what: What the arm is called in messages.

    Raises:
        NotFoundError: The arm has no such site.
        ModelError: The arm has no root body or several, or MuJoCo refuses the whole.
    """
    roots = [body.name for body in arm.worldbody.bodies]
    if len(roots) != 1 or len(arm.worldbody.geoms):
        raise ModelError(
            f"{what} has the bodies {roots} and {len(arm.worldbody.geoms)} geoms in its world; an "
            "arm is one tree of bodies: remove the rest, or put it into the tree"
        )
    name_parts(arm)
    model = compile_spec(arm, what)
    sites = [model.site(i).name for i in range(model.nsite)]
    if site not in sites:
        raise NotFoundError(f"site of {what}", site, sites, "A hand is attached to a site.")
    number = model.site(site).id
    T_body_site = pose_from_wxyz(model.site_pos[number], model.site_quat[number])
    position, quaternion = pose_to_wxyz(T_body_site * T_site_base)
    _exclude_root(arm, model)
    out = mujoco.MjSpec()
    out.attach(arm, prefix=ARM_PREFIX, frame=out.worldbody.add_frame())
    carrier = out.site(ARM_PREFIX + site).parent
    frame = carrier.add_frame(pos=np.array(position), quat=np.array(quaternion))
    # MuJoCo warns that names without prefix are lost in a saved file; none is written
    out.attach(hand, prefix="", frame=frame)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Attaching a spec with an empty prefix")
        compile_spec(out, f"{what} with its hand")
    return out.copy(), ARM_PREFIX + roots[0]


def take_off_arm(spec: Any, link: str, what: str) -> None:
    """Take the arm off a spec of a hand on an arm, in place, but for its last link, which stands.

    Args:
        spec: ``mujoco.MjSpec`` of both, as ``mount_spec`` makes it.
        link: Body of that link.
        what: What it is called in messages.
    """
    isolate_base(spec, link, what)
    delete_joints(spec, list(spec.body(link).joints))


def _exclude_root(arm: Any, model: Any) -> None:
    """Let the root and what its joints carry touch, as parent and child may everywhere else.

    MuJoCo lets them collide where the parent is fixed to the world, as the root of an arm is.
    """
    names = [model.body(i).name for i in range(model.nbody)]
    static = [i for i in range(1, model.nbody) if model.body_weldid[i] == 0]
    excluded = {frozenset((e.bodyname1, e.bodyname2)) for e in arm.excludes}
    for i in range(1, model.nbody):
        if model.body_weldid[i] == 0 or model.body_weldid[model.body_parentid[i]] != 0:
            continue
        for j in static:
            if frozenset((names[i], names[j])) not in excluded:
                arm.add_exclude(bodyname1=names[j], bodyname2=names[i])


@dataclass(frozen=True, kw_only=True)
class JointServo:
    """A driven joint of a carriage.

    Attributes:
        slides: Whether it slides or turns.
        most: Its range to either side, m or rad.
        kp: Stiffness of its position servo, N/m or N m/rad.
        kv: Damping, N s/m or N m s/rad.
        force: Largest force, N or N m.
    """

    slides: bool
    most: float
    kp: float
    kv: float
    force: float


@dataclass(frozen=True, kw_only=True)
class Carried:
    """A hand on a carriage.

    Attributes:
        name: Names of its model begin with it.
        spec: ``mujoco.MjSpec`` of the hand; attached, so give a fresh one.
        T_root_carriage: Pose of the carriage at rest.
        T_carriage_base: Pose of the hand's base on it.
        servos: Its joints in order, slides before hinges; none of a hand that brings an arm.
    """

    name: str
    spec: Any
    T_root_carriage: SE3
    T_carriage_base: SE3
    servos: Sequence[JointServo]


def carried_spec(
    what: str,
    root: str,
    carried: Sequence[Carried],
    axes: Sequence[str],
    *,
    mass: float,
    radius: float,
) -> Any:
    """A spec of hands on carriages, under one root body.

    Args:
        what: Name of the whole.
        root: Name of the root body.
        carried: The hands.
        axes: Names of a carriage's joints.
        mass: Of the root and of each carriage, kg.
        radius: Of the ball of that mass whose moment of inertia they have, m.

    Raises:
        ModelError: MuJoCo refuses the whole.
    """
    out = mujoco.MjSpec()
    out.compiler.degree = False
    out.modelname = what
    base = out.worldbody.add_body(name=root)
    bodies = [base]
    for hand in carried:
        position, quaternion = pose_to_wxyz(hand.T_root_carriage)
        body = base.add_body(name=f"{hand.name}/carriage", pos=position, quat=quaternion)
        bodies.append(body)
        for k, (axis, servo) in enumerate(zip(axes, hand.servos, strict=bool(hand.servos))):
            _drive(out, body, f"{hand.name}/carriage_{axis}", np.eye(3)[k % 3], servo)
        position, quaternion = pose_to_wxyz(hand.T_carriage_base)
        frame = body.add_frame(pos=position, quat=quaternion)
        out.attach(hand.spec, prefix=f"{hand.name}/", frame=frame)
    for body in bodies:
        body.explicitinertial = True
        body.mass, body.inertia = mass, np.full(3, 0.4 * mass * radius**2)
    compile_spec(out, what)
    return out.copy()


def _drive(spec: Any, body: Any, name: str, axis: FloatArray, servo: JointServo) -> None:
    """Add a joint and its position servo."""
    kinds, limited = mujoco.mjtJoint, mujoco.mjtLimited.mjLIMITED_TRUE
    joint = body.add_joint(name=name, axis=axis, range=(-servo.most, servo.most), limited=limited)
    joint.type = kinds.mjJNT_SLIDE if servo.slides else kinds.mjJNT_HINGE
    actuator = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    actuator.set_to_position(kp=servo.kp, kv=servo.kv)
    actuator.forcelimited = actuator.ctrllimited = limited
    actuator.forcerange = (-servo.force, servo.force)
    actuator.ctrlrange = (-servo.most, servo.most)


_EQ_TENDON = int(mujoco.mjtEq.mjEQ_TENDON)


def motorise_spec(spec: Any, what: str) -> None:
    """Replace the actuators and tendons of a spec of hinges and slides by motors, in place.

    A motor is called like its joint. A joint that nothing drives gets none.

    Args:
        spec: ``mujoco.MjSpec``, with named parts and all of its equalities.
        what: What it is called in messages.

    Raises:
        HandError: An actuator without limits of its force.
        ModelError: MuJoCo refuses the model, or it has actuators or equalities that are not linear.
    """
    actuation = actuation_from_mujoco(compile_spec(spec, what))
    endless = [
        name
        for name, ends in zip(actuation.names, actuation.force_range, strict=True)
        if not np.isfinite(ends).all()
    ]
    if endless:
        raise HandError(
            f"{what}: a motor needs the greatest torque of its joint, and the actuators {endless} "
            "have no limit; give each a forcerange"
        )
    torque = np.zeros((len(actuation.joint_names), 2))
    for arms, ends in zip(actuation.moment, actuation.force_range, strict=True):
        torque += np.sort(np.outer(arms, ends), axis=1)
    held = {n for e in spec.equalities if int(e.type) == _EQ_TENDON for n in (e.name1, e.name2)}
    for part in (*spec.actuators, *(t for t in spec.tendons if t.name not in held)):
        spec.delete(part)
    for joint in spec.joints:
        joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_FALSE  # counted in the force ranges
    for name, ends in zip(actuation.joint_names, torque, strict=True):
        if not ends.any():
            continue
        motor = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        motor.set_to_motor()
        motor.forcelimited = motor.ctrllimited = mujoco.mjtLimited.mjLIMITED_TRUE
        motor.forcerange = motor.ctrlrange = ends
