"""A compiled ``MjModel`` turned back into an ``MjSpec``, as far as a hand needs it.

Only a spec can be edited or attached to a scene, and MuJoCo makes none from a model. Bodies,
joints, geoms with their meshes, sites, fixed tendons, actuators,
couplings, and which bodies may touch are read back; pictures (textures, cameras, lights), sensors
and key frames are not.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np

from planner.bridge.pinocchio_model import body_name
from planner.errors import ModelError

_MESH = int(mujoco.mjtGeom.mjGEOM_MESH)
_HFIELD = int(mujoco.mjtGeom.mjGEOM_HFIELD)
_SDF = int(mujoco.mjtGeom.mjGEOM_SDF)
_WRAP_JOINT = int(mujoco.mjtWrap.mjWRAP_JOINT)
_EQ_JOINT, _EQ_TENDON = int(mujoco.mjtEq.mjEQ_JOINT), int(mujoco.mjtEq.mjEQ_TENDON)
_ON = mujoco.mjtLimited.mjLIMITED_TRUE
_OFF = mujoco.mjtLimited.mjLIMITED_FALSE

_GEOM_FIELDS = (
    *("contype", "conaffinity", "condim", "priority", "friction", "solmix", "solref", "solimp"),
    *("margin", "gap", "group", "size", "pos", "quat"),
)
_JOINT_FIELDS = ("axis", "pos", "range", "margin", "group")
_TENDON_FIELDS = ("range", "margin", "group", "width", "rgba", "frictionloss", "armature")
_ACTUATOR_FIELDS = (
    *("gear", "gainprm", "biasprm", "dynprm", "ctrlrange", "forcerange", "actrange", "lengthrange"),
    *("ctrlspec", "cranklength", "group", "actearly"),
)


def spec_from_model(model: Any) -> Any:
    """A ``mujoco.MjSpec`` that compiles to the same hand as a ``mujoco.MjModel``.

    Raises:
        ModelError: The model has a part that is not read back: a spatial tendon, an equality
            between bodies, an actuator on a site or body, a height field or a distance field.
    """
    spec = mujoco.MjSpec()
    spec.modelname = model.names[: model.names.index(b"\0")].decode() or "model"
    spec.compiler.degree = False
    spec.option.gravity = model.opt.gravity
    for k in range(model.nmesh):
        _add_mesh(spec, model, k)
    bodies = [spec.worldbody]
    for b in range(1, model.nbody):
        bodies.append(_add_body(bodies[int(model.body_parentid[b])], model, b))
    for j in range(model.njnt):
        _add_joint(bodies[int(model.jnt_bodyid[j])], model, j)
    for g in range(model.ngeom):
        _add_geom(bodies[int(model.geom_bodyid[g])], model, g)
    for s in range(model.nsite):
        site = bodies[int(model.site_bodyid[s])].add_site(name=model.site(s).name)
        _copy(model, "site", s, site, ("pos", "quat", "size", "rgba", "group", "type"))
    for t in range(model.ntendon):
        _add_tendon(spec, model, t)
    for i in range(model.nactuator):
        _add_actuator(spec, model, i)
    for e in range(model.neq):
        _add_equality(spec, model, e)
    for signature in model.exclude_signature[: model.nexclude]:
        first, second = (
            body_name(model, b) for b in (int(signature) >> 16, int(signature) & 65535)
        )
        spec.add_exclude(bodyname1=first, bodyname2=second)
    return spec


def _copy(model: Any, kind: str, i: int, part: Any, fields: tuple[str, ...]) -> None:
    """Copy ``model.<kind>_<field>[i]`` to ``part.<field>``."""
    for name in fields:
        value = getattr(model, f"{kind}_{name}")[i]
        setattr(part, name, value if np.ndim(value) else value.item())


def _limit(model: Any, kind: str, i: int, part: Any, fields: tuple[str, ...]) -> None:
    """Copy whether a range counts: ``model.<kind>_<field>[i]``."""
    for name in fields:
        setattr(part, name, _ON if getattr(model, f"{kind}_{name}")[i] else _OFF)


def _add_mesh(spec: Any, model: Any, k: int) -> None:
    start, count = int(model.mesh_vertadr[k]), int(model.mesh_vertnum[k])
    first, faces = int(model.mesh_faceadr[k]), int(model.mesh_facenum[k])
    spec.add_mesh(
        name=f"mesh{k}",
        uservert=model.mesh_vert[start : start + count].ravel(),
        userface=model.mesh_face[first : first + faces].ravel(),
        inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX,  # never refused; masses are explicit
    )


def _add_body(parent: Any, model: Any, b: int) -> Any:
    body = parent.add_body(name=body_name(model, b))
    _copy(model, "body", b, body, ("pos", "quat", "gravcomp"))
    body.mocap = bool(model.body_mocapid[b] >= 0)
    if model.body_mass[b] > 0:
        body.explicitinertial = True
        _copy(model, "body", b, body, ("mass", "ipos", "iquat", "inertia"))
    return body


def _add_joint(body: Any, model: Any, j: int) -> None:
    kind, dof = int(model.jnt_type[j]), int(model.jnt_dofadr[j])
    joint = body.add_joint(name=model.joint(j).name, type=mujoco.mjtJoint(kind))
    _copy(model, "jnt", j, joint, _JOINT_FIELDS)
    _limit(model, "jnt", j, joint, ("limited", "actfrclimited"))
    joint.actfrcrange = model.jnt_actfrcrange[j]
    joint.solref_limit, joint.solimp_limit = model.jnt_solref[j], model.jnt_solimp[j]
    joint.stiffness = [model.jnt_stiffness[j], *model.jnt_stiffnesspoly[j]]
    if kind in (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)):
        joint.ref = float(model.qpos0[int(model.jnt_qposadr[j])])
        joint.springref = float(model.qpos_spring[int(model.jnt_qposadr[j])])
    joint.damping = [model.dof_damping[dof], *model.dof_dampingpoly[dof]]
    joint.armature = float(model.dof_armature[dof])
    joint.frictionloss = float(model.dof_frictionloss[dof])
    joint.solref_friction, joint.solimp_friction = model.dof_solref[dof], model.dof_solimp[dof]


def _add_geom(body: Any, model: Any, g: int) -> None:
    kind = int(model.geom_type[g])
    if kind in (_HFIELD, _SDF):
        if body.name == "world":
            return  # scenery
        raise ModelError(
            f"geom {model.geom(g).name!r} is a height field or a distance field, and cannot be "
            "read back from a compiled model; give the MjSpec or the file instead"
        )
    geom = body.add_geom(name=model.geom(g).name, type=mujoco.mjtGeom(kind))
    _copy(model, "geom", g, geom, _GEOM_FIELDS)
    if kind == _MESH:
        geom.meshname = f"mesh{int(model.geom_dataid[g])}"
    material = int(model.geom_matid[g])
    geom.rgba = model.geom_rgba[g] if material < 0 else model.mat_rgba[material]


def _add_tendon(spec: Any, model: Any, t: int) -> None:
    tendon = spec.add_tendon(name=model.tendon(t).name or f"tendon{t}")
    _copy(model, "tendon", t, tendon, _TENDON_FIELDS)
    _limit(model, "tendon", t, tendon, ("limited", "actfrclimited"))
    tendon.actfrcrange = model.tendon_actfrcrange[t]
    tendon.solref_limit, tendon.solimp_limit = (
        model.tendon_solref_lim[t],
        model.tendon_solimp_lim[t],
    )
    tendon.solref_friction = model.tendon_solref_fri[t]
    tendon.solimp_friction = model.tendon_solimp_fri[t]
    tendon.stiffness = [model.tendon_stiffness[t], *model.tendon_stiffnesspoly[t]]
    tendon.damping = [model.tendon_damping[t], *model.tendon_dampingpoly[t]]
    tendon.springlength = model.tendon_lengthspring[t]
    start = int(model.tendon_adr[t])
    for w in range(start, start + int(model.tendon_num[t])):
        if int(model.wrap_type[w]) != _WRAP_JOINT:
            raise ModelError(
                f"tendon {tendon.name!r} runs through space, and cannot be read back from a "
                "compiled model; give the MjSpec or the file instead"
            )
        tendon.wrap_joint(model.joint(int(model.wrap_objid[w])).name, float(model.wrap_prm[w]))


def _add_actuator(spec: Any, model: Any, i: int) -> None:
    name, kind = model.actuator(i).name, int(model.actuator_trntype[i])
    targets: dict[int, Callable[[int], Any]] = {
        int(mujoco.mjtTrn.mjTRN_JOINT): model.joint,
        int(mujoco.mjtTrn.mjTRN_JOINTINPARENT): model.joint,
        int(mujoco.mjtTrn.mjTRN_TENDON): model.tendon,
    }
    if kind not in targets:
        raise ModelError(
            f"actuator {name!r} drives neither a joint nor a tendon, and cannot be read back from "
            "a compiled model; give the MjSpec or the file instead"
        )
    target = targets[kind](int(model.actuator_trnid[i, 0])).name
    actuator = spec.add_actuator(name=name, target=target, trntype=mujoco.mjtTrn(kind))
    for law in ("gaintype", "biastype", "dyntype"):
        enum = {"gaintype": mujoco.mjtGain, "biastype": mujoco.mjtBias, "dyntype": mujoco.mjtDyn}
        setattr(actuator, law, enum[law](int(getattr(model, f"actuator_{law}")[i])))
    _copy(model, "actuator", i, actuator, _ACTUATOR_FIELDS)
    _limit(model, "actuator", i, actuator, ("ctrllimited", "forcelimited", "actlimited"))


def _add_equality(spec: Any, model: Any, e: int) -> None:
    kind = int(model.eq_type[e])
    name = model.equality(e).name
    if kind not in (_EQ_JOINT, _EQ_TENDON):
        raise ModelError(
            f"equality {name!r} ties bodies, and cannot be read back from a compiled model; give "
            "the MjSpec or the file instead"
        )
    part = model.joint if kind == _EQ_JOINT else model.tendon
    equality = spec.add_equality(name=name, type=mujoco.mjtEq(kind))
    equality.name1 = part(int(model.eq_obj1id[e])).name
    if model.eq_obj2id[e] >= 0:
        equality.name2 = part(int(model.eq_obj2id[e])).name
    equality.data[: model.eq_data.shape[1]] = model.eq_data[e]
    equality.active = bool(model.eq_active0[e])
    equality.solref, equality.solimp = model.eq_solref[e], model.eq_solimp[e]
