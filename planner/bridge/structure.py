"""The structure of a compiled MuJoCo model as plain data, from which descriptions are proposed.

Bodies, joints, geoms, sites, actuators and fixed tendons with the numbers that distinguish a finger
from a wrist, a pad from a shell, or a servo from a spring. No decision is made here.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from planner.bridge.decompile import spec_from_model
from planner.bridge.load import load_spec
from planner.bridge.mesh_files import convert_meshes
from planner.bridge.pinocchio_model import (
    actuator_row,
    body_name,
    is_fixed_tendon,
    links_of,
    tendon_row,
    tied_bodies,
)
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
