"""The structure of a compiled MuJoCo model as plain data, from which descriptions are proposed.

Bodies, joints, geoms, sites, actuators and fixed tendons with the numbers that distinguish a finger
from a wrist, a pad from a shell, or a servo from a spring. No decision is made here.

``spec_from_model`` turns a compiled model back into an ``MjSpec``, as far as a hand needs it: only
a spec can be edited or attached to a scene, and MuJoCo makes none from a model. Bodies, joints,
geoms with their meshes, sites, fixed tendons, actuators, couplings, and which bodies may touch are
read back; pictures (textures, cameras, lights), sensors and key frames are not.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from planner.bridge.load import convert_meshes, load_spec
from planner.bridge.pinocchio_model import (
    actuator_row,
    body_name,
    is_fixed_tendon,
    links_of,
    tendon_row,
    tied_bodies,
)
from planner.errors import ModelError
from planner.spatial import FloatArray

_HINGE, _SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)
_SITE = int(mujoco.mjtObj.mjOBJ_SITE)
_BIAS_AFFINE = int(mujoco.mjtBias.mjBIAS_AFFINE)


@dataclass(frozen=True, kw_only=True)
class BodyPart:
    """A body: ``parent`` and ``link`` are numbers of bodies; bodies of one link move as one.

    Attributes:
        name: Its name.
        parent: The body that it is attached to (the world's is itself, 0).
        link: The first body of the rigid link that it is part of (0: fixed to the world).
        mass: kg.
    """

    name: str
    parent: int
    link: int
    mass: float


@dataclass(frozen=True, kw_only=True)
class JointPart:
    """A joint.

    Attributes:
        name: Its name.
        body: Number of the body that it moves.
        kind: "hinge", "slide" or "other" (ball, free).
        limits: Lower and upper end of its range, rad or m; None if it has none.
        damping: N m s/rad (N s/m).
        frictionloss: N m (N).
        armature: Inertia of its rotor seen from the joint, kg m^2 (kg).
        effort: Largest torque the model lets actuators put on it, N m (N); infinite if not said.
    """

    name: str
    body: int
    kind: str
    limits: tuple[float, float] | None
    damping: float
    frictionloss: float
    armature: float
    effort: float


@dataclass(frozen=True, kw_only=True, eq=False)
class ActuatorPart:
    """An actuator.

    Attributes:
        name: Its name.
        row: Moment arms (nv,), m/rad or -; zero if they depend on q.
        stiffness: Force per length by which it holds its target, N m/rad; 0 if it does not.
        force_limit: Largest force, N m; infinite if not limited.
    """

    name: str
    row: FloatArray
    stiffness: float
    force_limit: float


@dataclass(frozen=True, kw_only=True, eq=False)
class TendonPart:
    """A fixed tendon, length = row @ q.

    Attributes:
        name: Its name.
        row: Coefficients (nv,).
        limits: Least and greatest length; None if not limited.
        stiffness: Of its spring, N/m; 0 if it has none.
        rest: Lengths between which the spring pulls nothing.
    """

    name: str
    row: FloatArray
    limits: tuple[float, float] | None
    stiffness: float
    rest: tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class ModelStructure:
    """Everything above of one model, in the model's order; nv is the number of joints.

    ``loops`` are the active equalities that tie two links and so close a loop: name, both bodies.
    """

    bodies: tuple[BodyPart, ...]
    joints: tuple[JointPart, ...]
    actuators: tuple[ActuatorPart, ...]
    tendons: tuple[TendonPart, ...]
    loops: tuple[tuple[str, int, int], ...] = ()

    @property
    def hinges_and_slides(self) -> bool:
        """Whether all joints are hinges or slides, so that joint j is degree of freedom j."""
        return all(j.kind != "other" for j in self.joints)

    def children(self, link: int) -> list[int]:
        """Numbers of the links attached to a link by joints, in the model's order."""
        bodies = self.bodies
        return [
            i
            for i, b in enumerate(bodies)
            if i and b.link == i and bodies[b.parent].link == link and self.joints_of(i)
        ]

    def joints_of(self, body: int) -> list[int]:
        """Numbers of the joints of a body."""
        return [k for k, j in enumerate(self.joints) if j.body == body]

    def bodies_of(self, link: int) -> list[int]:
        """Numbers of the bodies of a rigid link, the first one first."""
        return [i for i, b in enumerate(self.bodies) if b.link == link]


def read_spec(source: Any) -> Any:
    """A fresh ``mujoco.MjSpec`` from a path, a spec, or a compiled model.

    Raises:
        ModelError: The file is missing or not a model, or a compiled model cannot be taken apart.
    """
    if isinstance(source, mujoco.MjModel):
        return spec_from_model(source)
    if isinstance(source, Path):
        return load_spec(source)
    spec = source.copy()
    convert_meshes(spec)
    return spec


def structure_of(model: Any) -> ModelStructure:
    """The structure of a compiled ``mujoco.MjModel``; tendons through space are left out."""
    return ModelStructure(
        bodies=tuple(
            BodyPart(
                name=body_name(model, i),
                parent=int(model.body_parentid[i]),
                link=int(model.body_weldid[i]),
                mass=float(model.body_mass[i]),
            )
            for i in range(model.nbody)
        ),
        joints=tuple(_joint(model, j) for j in range(model.njnt)),
        actuators=tuple(_actuator(model, i) for i in range(model.nu)),
        tendons=tuple(_tendon(model, t) for t in range(model.ntendon) if is_fixed_tendon(model, t)),
        loops=tuple(
            (model.equality(e).name or f"equality{e}", *tied)
            for e in map(int, np.flatnonzero(model.eq_active0))
            if (tied := tied_bodies(model, e)) and len(links_of(model, tied) - {0}) == 2
        ),
    )


def _joint(model: Any, j: int) -> JointPart:
    kind = int(model.jnt_type[j])
    first = int(model.jnt_dofadr[j])
    low, high = (float(v) for v in model.jnt_range[j])
    limited = bool(model.jnt_limited[j]) and kind in (_HINGE, _SLIDE)
    effort = np.inf
    if model.jnt_actfrclimited[j]:
        effort = float(np.abs(model.jnt_actfrcrange[j]).max())
    return JointPart(
        name=model.joint(j).name,
        body=int(model.jnt_bodyid[j]),
        kind={_HINGE: "hinge", _SLIDE: "slide"}.get(kind, "other"),
        limits=(low, high) if limited else None,
        damping=float(model.dof_damping[first]),
        frictionloss=float(model.dof_frictionloss[first]),
        armature=float(model.dof_armature[first]),
        effort=effort,
    )


def _actuator(model: Any, i: int) -> ActuatorPart:
    row = actuator_row(model, i)
    affine = int(model.actuator_biastype[i]) == _BIAS_AFFINE
    limited = bool(model.actuator_forcelimited[i])
    return ActuatorPart(
        name=model.actuator(i).name,
        row=np.zeros(model.nv) if row is None else row,
        stiffness=-float(model.actuator_biasprm[i, 1]) if affine else 0.0,
        force_limit=float(np.abs(model.actuator_forcerange[i]).max()) if limited else np.inf,
    )


def _tendon(model: Any, t: int) -> TendonPart:
    low, high = (float(v) for v in model.tendon_range[t])
    first, last = (float(v) for v in model.tendon_lengthspring[t])
    return TendonPart(
        name=model.tendon(t).name,
        row=tendon_row(model, t),
        limits=(low, high) if model.tendon_limited[t] else None,
        stiffness=float(model.tendon_stiffness[t]),
        rest=(first, last),
    )


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
