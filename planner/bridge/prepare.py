"""From a foreign model to the model of a hand alone: repaired, isolated, named.

``isolate_base`` and ``name_parts`` need no description, so that one can be proposed from what they
leave; ``repair_spec`` and ``add_described_parts`` do what a description asks for. All change a
``mujoco.MjSpec`` in place.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import mujoco
import numpy as np

from planner.bridge.load import RIGID_SOLIMP, RIGID_SOLREF, compile_spec
from planner.bridge.numbers import check_repeated_names, check_sizes
from planner.bridge.pinocchio_model import tendon_row
from planner.errors import HandError, NotFoundError
from planner.joints.description import ActuatorDescription, HandDescription

_FREE = int(mujoco.mjtJoint.mjJNT_FREE)
_QUATERNION = mujoco.mjtOrientation.mjORIENTATION_QUAT
_JOINT_WRAP = int(mujoco.mjtWrap.mjWRAP_JOINT)
_IDENTITY = (1.0, 0.0, 0.0, 0.0)

PID = "mujoco.pid"
"""Name of the plugin of MuJoCo's that is a servo with an integral."""

_USERS = {
    int(mujoco.mjtObj.mjOBJ_JOINT): (
        {int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT)},
        int(mujoco.mjtEq.mjEQ_JOINT),
    ),
    int(mujoco.mjtObj.mjOBJ_TENDON): (
        {int(mujoco.mjtTrn.mjTRN_TENDON)},
        int(mujoco.mjtEq.mjEQ_TENDON),
    ),
}
"""Kind of a target -> transmissions and the equality that name such targets."""


def prepare_spec(spec: Any, description: HandDescription, what: str) -> Any:
    """Repair, isolate and name a model as its description asks: all but ``add_described_parts``.

    Args:
        spec: ``mujoco.MjSpec`` as it was read; it is changed.
        description: Names the base and the repairs.
        what: What the model is called in messages.

    Returns:
        The spec; another one where the world becomes a body.

    Raises:
        NotFoundError: The base, or a part to be repaired, is not there.
    """
    if description.repair.angle is not None:
        spec.compiler.degree = description.repair.angle == "degree"
    spec.compiler.balanceinertia |= description.repair.balance_inertia
    if description.repair.world_body:
        spec = with_world_body(spec, description.repair.world_body)
    isolate_base(spec, description.base_body, what)
    name_parts(spec)
    repair_spec(spec, description, what)
    _replace_plugins(spec)
    for body in spec.bodies:  # whoever drives the hand bears its weight, and once
        body.gravcomp = 0.0
    return spec


def with_world_body(spec: Any, name: str) -> Any:
    """A spec whose world holds one body of a name, with all that was fixed to the world of another.

    Free bodies and planes (objects, floors) go; ``spec`` is changed.
    """
    for part in (*spec.keys, *spec.cameras, *spec.lights):
        spec.delete(part)
    for body in spec.worldbody.bodies:
        if any(int(joint.type) == _FREE for joint in body.joints):
            spec.delete(body)
    for geom in spec.worldbody.geoms:
        if int(geom.type) == int(mujoco.mjtGeom.mjGEOM_PLANE):
            spec.delete(geom)
    out = mujoco.MjSpec()
    out.modelname, out.option, out.compiler.fusestatic = spec.modelname, spec.option, False
    out.compiler.balanceinertia = spec.compiler.balanceinertia
    # MuJoCo warns, at the first compilation, that names without prefix are lost in a saved file
    out.attach(spec, prefix="", frame=out.worldbody.add_body(name=name).add_frame())
    return out.copy()


def _replace_plugins(spec: Any) -> None:
    """Let each actuator by MuJoCo's PID plugin be the servo of its kp and kd.

    The planner's law of an actuator is affine in command, length and velocity: ki and the limit on
    the command's speed have no place in it.
    """
    instances = {plugin.name: plugin.config for plugin in spec.plugins}
    for actuator in spec.actuators:
        if actuator.plugin.active and actuator.plugin.plugin_name == PID:
            gains = {**instances.get(actuator.plugin.name, {}), **actuator.plugin.config}
            actuator.plugin.active, actuator.actdim = False, -1
            actuator.set_to_position(kp=float(gains["kp"]), kv=float(gains.get("kd", 0.0)))
    for plugin in [p for p in spec.plugins if p.plugin_name == PID]:
        spec.delete(plugin)


def isolate_base(spec: Any, base_body: str, what: str) -> None:
    """Keep the subtree of the base alone and let its frame be the world's.

    Bodies beside the base, everything fixed to the world, key frames, sensors, cameras, lights and
    skins go. Bodies above the base stay as empty names at the origin; a free joint of the base
    goes too, since a floating base is what the planner places.

    Raises:
        NotFoundError: There is no such body.
        ModelError: Two parts of a kind share a name, or a part is larger than any.
    """
    check_repeated_names(spec, what)
    check_sizes(spec, what)
    base = _need(spec.bodies, "body", base_body, what)
    for part in (*spec.keys, *spec.sensors, *spec.cameras, *spec.lights, *spec.skins):
        spec.delete(part)
    above = [base]
    while above[-1].name != "world":
        above.append(above[-1].parent)
    for body, kept in zip(above[1:], above, strict=False):
        for other in body.bodies:
            if other.id != kept.id or other.name != kept.name:
                spec.delete(other)
    removed = [joint for body in above[1:] for joint in body.joints]
    removed += [joint for joint in base.joints if int(joint.type) == _FREE]
    delete_joints(spec, removed)
    for body in above[1:]:
        for part in (*body.geoms, *body.sites):
            spec.delete(part)
    for body in above[:-1]:
        _reset_pose(body)
    for body in above[1:-1]:
        body.explicitinertial, body.mass = False, 0.0


def name_parts(spec: Any) -> None:
    """Give a name to every body, joint, geom, tendon, actuator and equality that has none.

    A body is called ``<parent>_body<i>``, a geom ``<body>_geom<i>``, a joint ``<body>_joint<i>``, i
    counting those of that body (and of that parent) from 0; the rest after their kind.
    """
    bodies = _Names(spec.bodies)
    geoms, joints = _Names(spec.geoms), _Names(spec.joints)
    for body in spec.bodies:  # parents first
        for i, child in enumerate(body.bodies):
            bodies.give(child, f"{body.name}_body{i}")
        for i, geom in enumerate(body.geoms):
            geoms.give(geom, f"{body.name}_geom{i}")
        for i, joint in enumerate(body.joints):
            joints.give(joint, f"{body.name}_joint{i}")
    for parts, kind in (
        (spec.tendons, "tendon"),
        (spec.actuators, "actuator"),
        (spec.equalities, "equality"),
    ):
        names = _Names(parts)
        for i, part in enumerate(parts):
            names.give(part, f"{kind}{i}")


def repair_spec(spec: Any, description: HandDescription, what: str) -> None:
    """Apply ``[repair]`` and ``[joint_defaults]`` to the parts of a named model.

    Raises:
        NotFoundError: A geom, an equality or a body that the model does not have.
        HandError: A body that is to get the inertia of its geometry has none that collides.
    """
    repair = description.repair
    for name in repair.drop_collision:
        geom = _need(spec.geoms, "geom", name, what)
        geom.contype = geom.conaffinity = 0
    if repair.inertia_from_geometry:
        _set_inertias(spec, repair.inertia_from_geometry, what)
    for name in repair.drop_couplings:
        _drop_coupling(spec, name, what)
    for pair in repair.exclude:
        first, second = (_need(spec.bodies, "body", name, what).name for name in pair)
        spec.add_exclude(bodyname1=first, bodyname2=second)
    defaults = description.joint_defaults
    for joint in spec.joints:
        if defaults.damping is not None:
            joint.damping = [defaults.damping, 0.0, 0.0]  # of a polynomial in velocity
        if defaults.frictionloss is not None:
            joint.frictionloss = defaults.frictionloss
        if defaults.armature is not None:
            joint.armature = defaults.armature
        if defaults.least_armature is not None:
            joint.armature = max(joint.armature, defaults.least_armature)


def add_described_parts(spec: Any, description: HandDescription, what: str) -> None:
    """Add tip sites, servos and equalities that the model does not have.

    Raises:
        NotFoundError: A body, joint or tendon that the model does not have.
        HandError: A site of a tip's name is there already.
        ModelError: MuJoCo refuses the model as it is.
    """
    sites = {site.name for site in spec.sites}
    for finger in description.fingers:
        if finger.tip is None:
            continue
        if finger.tip_frame in sites:
            raise HandError(
                f"{what} has a site {finger.tip_frame!r} already; name it as tip_site of finger "
                f"{finger.name!r}, or rename the finger"
            )
        body = _need(spec.bodies, "body", finger.tip.body, what)
        body.add_site(name=finger.tip_frame, pos=finger.tip.position)
    equalities = [c for c in description.couplings if c.kind == "equality"]
    if not (description.actuators or equalities):
        return
    model = compile_spec(spec, what)  # angles of a spec may be in degrees, those of a model never
    for servo in description.actuators:
        for joint in servo.joints:
            _need(spec.joints, "joint", joint, what)
            j = model.joint(joint).id
            ends = model.jnt_range[j] if model.jnt_limited[j] else (-np.inf, np.inf)
            _add_servo(spec, servo, joint, mujoco.mjtTrn.mjTRN_JOINT, ends)
        if servo.tendon:
            _need(spec.tendons, "tendon", servo.tendon, what)
            reach = tendon_row(model, model.tendon(servo.tendon).id)[:, None] * model.jnt_range
            ends = reach.min(axis=1).sum(), reach.max(axis=1).sum()
            _add_servo(spec, servo, servo.tendon, mujoco.mjtTrn.mjTRN_TENDON, ends)
    for coupling in equalities:
        length0 = 0.0
        name = f"{coupling.name}_equality"
        tendon = spec.add_tendon(name=name)
        for joint, coefficient in coupling.joints.items():
            _need(spec.joints, "joint", joint, what)
            tendon.wrap_joint(joint, coefficient)
            length0 += coefficient * float(model.qpos0[model.joint(joint).qposadr[0]])
        equality = spec.add_equality(name=name, type=mujoco.mjtEq.mjEQ_TENDON, name1=name)
        equality.data[:5] = (coupling.value - length0, 1.0, 0.0, 0.0, 0.0)
        equality.solref, equality.solimp = RIGID_SOLREF, RIGID_SOLIMP


class _Names:
    """The names of parts of one kind, and new ones that differ from them."""

    def __init__(self, parts: Iterable[Any]) -> None:
        self.taken = {part.name for part in parts}

    def give(self, part: Any, name: str) -> None:
        """Name a part that has no name; underlines are added until the name is free."""
        if part.name:
            return
        while name in self.taken:
            name += "_"
        part.name = name
        self.taken.add(name)


def _add_servo(
    spec: Any, servo: ActuatorDescription, target: str, kind: Any, ctrl_range: Iterable[float]
) -> None:
    actuator = spec.add_actuator(target=target, trntype=kind)
    _Names(spec.actuators).give(actuator, target)
    actuator.set_to_position(kp=servo.kp, kv=servo.damping)
    actuator.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
    # a servo commanded at most to a joint's stop has no force left near it
    beyond = servo.force_limit / servo.kp
    low, high = (end + side * beyond for end, side in zip(ctrl_range, (-1.0, 1.0), strict=True))
    if np.isfinite(high - low):
        actuator.ctrllimited = mujoco.mjtLimited.mjLIMITED_TRUE
        actuator.ctrlrange = (low, high)
    actuator.forcerange = (-servo.force_limit, servo.force_limit)


def _set_inertias(spec: Any, names: Iterable[str], what: str) -> None:
    """Give bodies the inertia of a uniform solid of their mass, shaped as they collide.

    Raises:
        NotFoundError: The model has no such body.
        HandError: It has no geom that collides.
    """
    uniform, stated = spec.copy(), compile_spec(spec.copy(), what)
    for name in names:
        body = _need(uniform.bodies, "body", name, what)
        solid = [g for g in body.geoms if g.contype or g.conaffinity]
        if not solid:
            raise HandError(
                f"{what}: body {name!r} has no geom that collides; take it out of "
                "inertia_from_geometry, and correct its inertia in the model"
            )
        body.explicitinertial, body.ipos = False, np.full(3, np.nan)  # MuJoCo goes by the latter
        for geom in body.geoms:
            geom.mass, geom.density = np.nan, float(geom in solid)
    uniform.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_AUTO
    model = compile_spec(uniform, what)
    for name in names:
        b, body = model.body(name).id, _need(spec.bodies, "body", name, what)
        mass = float(stated.body(name).mass[0])
        body.explicitinertial, body.mass = True, mass
        body.ipos, body.iquat = stated.body(name).ipos, model.body_iquat[b]
        body.fullinertia, body.ialt.type = np.full(6, np.nan), _QUATERNION
        body.inertia = mass / model.body_mass[b] * model.body_inertia[b]


def _drop_coupling(spec: Any, name: str, what: str) -> None:
    parts = [p for p in (*spec.tendons, *spec.equalities) if p.name == name]
    if not parts:
        available = [p.name for p in (*spec.tendons, *spec.equalities)]
        raise NotFoundError(f"tendon or equality of {what}", name, available)
    tendons = {t.name for t in spec.tendons if t.name == name}
    _delete_users(spec, tendons, int(mujoco.mjtObj.mjOBJ_TENDON))
    for equality in [e for e in spec.equalities if e.name == name]:
        spec.delete(equality)
    for tendon in [t for t in spec.tendons if t.name in tendons]:
        spec.delete(tendon)


def delete_joints(spec: Any, joints: list[Any]) -> None:
    """Delete joints with the actuators, equalities and tendons that refer to them."""
    names = {joint.name for joint in joints}
    _delete_users(spec, names, int(mujoco.mjtObj.mjOBJ_JOINT))
    for joint in joints:
        spec.delete(joint)
    torn = [
        tendon
        for tendon in spec.tendons
        if any(int(wrap.type) == _JOINT_WRAP and wrap.target is None for wrap in tendon.path)
    ]
    _delete_users(spec, {t.name for t in torn}, int(mujoco.mjtObj.mjOBJ_TENDON))
    for tendon in torn:
        spec.delete(tendon)


def _delete_users(spec: Any, names: set[str], kind: int) -> None:
    """Delete the actuators and equalities that refer to joints or tendons of these names."""
    transmission, equality_type = _USERS[kind]
    for actuator in spec.actuators:
        if int(actuator.trntype) in transmission and actuator.target in names:
            spec.delete(actuator)
    for equality in spec.equalities:
        if int(equality.type) == equality_type and {equality.name1, equality.name2} & names:
            spec.delete(equality)


def _reset_pose(body: Any) -> None:
    """Put a body, and the frames that carry it, at the origin of its parent."""
    parts = [body]
    while parts[-1].frame is not None:
        parts.append(parts[-1].frame)
    for part in parts:
        part.pos, part.quat, part.alt.type = np.zeros(3), _IDENTITY, _QUATERNION


def _need(parts: Iterable[Any], kind: str, name: str, what: str) -> Any:
    """The part of a name.

    Raises:
        NotFoundError: There is none.
    """
    named = {part.name: part for part in parts}
    if name not in named:
        raise NotFoundError(
            f"{kind} of {what}", name, [n for n in named if n], "Correct the hand's description."
        )
    return named[name]
