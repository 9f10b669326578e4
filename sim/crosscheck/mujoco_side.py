"""A compiled MuJoCo model as a side of a cross-check: the reference, or the other of two models.

Smooth dynamics only: contacts, limits, dry friction, equalities, actuators and springs are off in a
copy of the model, and so are the forces that Pinocchio has no place for (see ``left_out``).
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from functools import cached_property
from typing import Any

import mujoco
import numpy as np

from planner.bridge.pinocchio_model import body_name, joint_name, site_name
from planner.spatial import SE3, FloatArray
from sim.crosscheck.parts import (
    KINDS,
    BoolArray,
    JointFacts,
    Layout,
    LinkInertia,
    Observation,
    Parts,
    Slot,
    State,
)

_PUSH = 1e9
"""Control, far outside of any range, that drives an actuator to its force limit."""

_UNBOUNDED = 1e6
"""Torque, N m, above which an actuator driven by ``_PUSH`` is taken to have no limit."""


def efforts(model: Any) -> FloatArray:
    """Torques (nv, 2) that MuJoCo itself applies when every actuator is driven to its limit.

    Infinite where an actuator has no limit. Where no actuator acts, it is the joint's own
    ``actuatorfrcrange``, which MuJoCo reads from the effort of a URDF, or infinite.
    """
    out = np.zeros((model.nv, 2))
    if model.nu:
        m = copy(model)
        m.opt.disableflags = int(mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL)
        m.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
        m.actuator_actlimited[:] = 0
        data = mujoco.MjData(m)
        mujoco.mj_forward(m, data)
        moment = np.zeros((m.nu, m.nv))
        mujoco.mju_sparse2dense(
            moment,
            data.actuator_moment,
            data.moment_rownnz,
            data.moment_rowadr,
            data.moment_colind,
        )
        for dof in range(m.nv):
            for k, sign in enumerate((-1.0, 1.0)):
                data.ctrl[:] = sign * np.sign(moment[:, dof]) * np.sign(m.actuator_gainprm[:, 0])
                data.ctrl *= _PUSH
                if m.na:
                    driven = np.flatnonzero(m.actuator_actadr >= 0)
                    last = m.actuator_actadr[driven] + m.actuator_actnum[driven] - 1
                    data.act[last] = data.ctrl[driven]
                mujoco.mj_fwdActuation(m, data)
                out[dof, k] = data.qfrc_actuator[dof]
    out[np.abs(out) > _UNBOUNDED] *= np.inf
    idle = np.asarray(~out.any(axis=1))
    out[idle] = [-np.inf, np.inf]
    for j in np.flatnonzero(model.jnt_actfrclimited):
        if idle[int(model.jnt_dofadr[j])]:
            out[int(model.jnt_dofadr[j])] = model.jnt_actfrcrange[j]
    return out


def link_inertia(model: Any, data: Any, root: int) -> LinkInertia | None:
    """A moving body with all bodies fixed to it; None if they have no inertia.

    Args:
        model: ``mujoco.MjModel``.
        data: ``mujoco.MjData`` at any configuration.
        root: Number of the moving body.
    """
    parts = [
        _inertia(model, data, b, root)
        for b in range(root, model.nbody)
        if int(model.body_weldid[b]) == root
    ]
    mass = sum(part.mass for part in parts)
    if mass <= 0 and not any(part.inertia.any() for part in parts):
        return None
    moment = sum((part.mass * part.center for part in parts), np.zeros(3))
    center = moment / mass if mass > 0 else moment
    tensor = sum(
        (part.inertia + part.mass * _about(part.center - center) for part in parts),
        np.zeros((3, 3)),
    )
    return LinkInertia(mass=mass, center=center, inertia=tensor)


def body_inertia(model: Any, data: Any, body: int) -> LinkInertia:
    """One body alone, in its own frame."""
    return _inertia(model, data, body, body)


def _inertia(model: Any, data: Any, body: int, frame: int) -> LinkInertia:
    """One body in the frame of another that it is fixed to, from where MuJoCo puts its mass."""
    axes = data.xmat[frame].reshape(3, 3).T
    turn = axes @ data.ximat[body].reshape(3, 3)
    return LinkInertia(
        mass=float(model.body_mass[body]),
        center=axes @ (data.xipos[body] - data.xpos[frame]),
        inertia=turn @ np.diag(model.body_inertia[body]) @ turn.T,
    )


def _about(p: FloatArray) -> FloatArray:
    """Inertia (3, 3) about the origin of a unit mass at p (parallel axes)."""
    return np.asarray(p @ p * np.eye(3) - np.outer(p, p))


_OFF = (
    mujoco.mjtDisableBit.mjDSBL_CONSTRAINT,
    mujoco.mjtDisableBit.mjDSBL_ACTUATION,
    mujoco.mjtDisableBit.mjDSBL_SPRING,
    mujoco.mjtDisableBit.mjDSBL_SENSOR,
)


def layout_of(model: Any) -> Layout:
    """Names and order of a compiled model."""
    names = [body_name(model, b) for b in range(model.nbody)]
    joints = []
    for j in range(model.njnt):
        kind = KINDS[int(model.jnt_type[j])]
        q, v = int(model.jnt_qposadr[j]), int(model.jnt_dofadr[j])
        nq, nv = {"free": (7, 6), "ball": (4, 3)}.get(kind, (1, 1))
        joints.append(
            Slot(
                name=joint_name(model, j),
                kind=kind,
                body=names[int(model.jnt_bodyid[j])],
                q=slice(q, q + nq),
                v=slice(v, v + nv),
            )
        )
    return Layout(
        joints=tuple(joints),
        parents={names[b]: names[int(model.body_parentid[b])] for b in range(1, model.nbody)},
        roots={names[b]: names[_root(model, b)] for b in range(model.nbody)},
        sites={site_name(model, s): names[int(model.site_bodyid[s])] for s in range(model.nsite)},
        nq=int(model.nq),
        nv=int(model.nv),
        q_drawn=np.array(model.qpos0),
    )


def left_out(model: Any) -> tuple[str, ...]:
    """Forces and features of a model that are not compared, because Pinocchio has none of them."""
    found = {
        "springs": model.jnt_stiffness.any() or model.tendon_stiffness.any(),
        "damping that is a polynomial (its linear part is compared)": model.dof_dampingpoly.any(),
        "damping of tendons": model.tendon_damping.any(),
        "armature of tendons": model.tendon_armature.any(),
        "gravity compensation": model.body_gravcomp.any(),
        "fluid forces": model.opt.density > 0 or model.opt.viscosity > 0,
        "flexible bodies": model.nflex > 0,
        "plugins": model.nplugin > 0,
    }
    return tuple(name for name, present in found.items() if present)


def _root(model: Any, body: int) -> int:
    """The moving body that a body is fixed to, or 0: a mocap body stands still without a user."""
    weld = int(model.body_weldid[body])
    return weld if model.body_dofnum[weld] else 0


class MujocoSide:
    """A compiled model, seen in the names and the order of a reference."""

    def __init__(
        self,
        model: Any,
        name: str,
        layout: Layout,
        names: Mapping[str, str] | None = None,
        velocities: Mapping[str, float] | None = None,
    ) -> None:
        """Match the model's joints, bodies and sites with the reference's.

        Args:
            model: ``mujoco.MjModel``; it is copied.
            name: What the side is called in tables.
            layout: The reference's, of this model or of another.
            names: Reference's name -> this model's name, where they differ.
            velocities: Joint of this model -> largest speed that its URDF states, rad/s or m/s;
                None for a model of another kind: MuJoCo has no word for it.
        """
        self.name, self.layout = name, layout
        self.compiled, self.model = model, _smooth(model)
        self._data = mujoco.MjData(self.model)
        self._names = names or {}
        own = layout_of(model)
        self._own = own
        slots = {slot.name: slot for slot in own.joints}
        self._pairs = [
            (slot, slots[other])
            for slot in layout.joints
            if (other := self._other(slot.name)) in slots and slots[other].kind == slot.kind
        ]
        strength = efforts(model)
        self._joint_facts = {
            slot.name: _facts(model, slots[other], strength, velocities)
            for slot in layout.joints
            if (other := self._other(slot.name)) in slots
        }
        bodies = {body_name(model, b): b for b in range(model.nbody)}
        self._bodies = self._matched(layout.parents, bodies)
        self._sites = self._matched(
            layout.sites, {site_name(model, s): s for s in range(model.nsite)}
        )
        self._dofs = np.full(layout.nv, -1)
        for slot, mine in self._pairs:
            self._dofs[slot.v] = np.arange(mine.v.start, mine.v.stop)

    @property
    def bodies(self) -> Mapping[str, int]:
        """Body of the reference -> number of this model's body; the world is one."""
        return {"world": 0, **self._bodies}

    def _other(self, name: str) -> str:
        return self._names.get(name, name)

    def _matched(self, wanted: Mapping[str, str], present: Mapping[str, int]) -> dict[str, int]:
        return {name: present[self._other(name)] for name in wanted if self._other(name) in present}

    @property
    def moving(self) -> BoolArray:
        """Which degrees of freedom (nv,) of the reference it has, as booleans."""
        return np.asarray(self._dofs >= 0)

    @cached_property
    def _parts(self) -> Parts:
        lay, inverse = self.layout, {v: k for k, v in self._names.items()}
        others = [
            f"{kind} {name}"
            for kind, mine, theirs in (
                ("joint", [s.name for s in self._own.joints], {s.name for s in lay.joints}),
                ("body", self._own.parents, lay.parents),
                ("site", self._own.sites, lay.sites),
            )
            for name in mine
            if inverse.get(name, name) not in theirs
        ]
        data = mujoco.MjData(self.model)
        mujoco.mj_kinematics(self.model, data)
        movers = {n: b for n, b in self._bodies.items() if lay.roots[n] == n}
        links = {n: link_inertia(self.model, data, b) for n, b in movers.items()}
        return Parts(
            joints=self._joint_facts,
            links={n: link for n, link in links.items() if link is not None},
            inertias={n: body_inertia(self.model, data, b) for n, b in self._bodies.items()},
            bodies=frozenset(self._bodies),
            sites=frozenset(self._sites),
            gravity=np.array(self.model.opt.gravity),
            others=tuple(others),
        )

    def parts(self) -> Parts:
        """What does not depend on the configuration."""
        return self._parts

    def observe(self, state: State) -> Observation:
        """What MuJoCo computes at a state."""
        m, d, on = self.model, self._data, self.moving & state.moving
        mujoco.mj_resetData(m, d)
        qvel, torque = np.zeros(m.nv), np.zeros(m.nv)
        qpos = np.array(m.qpos0)
        for slot, mine in self._pairs:
            qpos[mine.q] = state.qpos[slot.q]
        dofs = self._dofs[on]
        qvel[dofs], torque[dofs] = state.qvel[on], state.torque[on]
        d.qpos[:], d.qvel[:], d.qfrc_applied[:] = qpos, qvel, torque
        mujoco.mj_forward(m, d)
        full = np.zeros((m.nv, m.nv))
        if m.nv:
            mujoco.mj_fullM(m, d, full)
        bias, acceleration = np.array(d.qfrc_bias), np.array(d.qacc_smooth)
        if len(dofs) < m.nv and len(dofs):  # joints that the reference has not do not move
            block = full[np.ix_(dofs, dofs)]
            force = (d.qfrc_applied + d.qfrc_passive - d.qfrc_bias)[dofs]
            acceleration = np.zeros(m.nv)
            acceleration[dofs] = np.linalg.solve(block, force)
        bodies = {n: _pose(d.xpos[b], d.xmat[b]) for n, b in self._bodies.items()}
        sites = {n: _pose(d.site_xpos[s], d.site_xmat[s]) for n, s in self._sites.items()}
        body_jacobians = {n: self._jacobian(mujoco.mj_jacBody, b) for n, b in self._bodies.items()}
        site_jacobians = {n: self._jacobian(mujoco.mj_jacSite, s) for n, s in self._sites.items()}
        centers = {
            n: np.array(d.subtree_com[b])
            for n, b in self._bodies.items()
            if self.layout.roots[n] == n and m.body_subtreemass[b] > 0
        }
        d.qvel[:] = 0
        mujoco.mj_forward(m, d)
        gravity = np.array(d.qfrc_bias)
        return Observation(
            bodies=bodies,
            sites=sites,
            body_jacobians=body_jacobians,
            site_jacobians=site_jacobians,
            mass_matrix=self.in_order(self.in_order(full).T),
            coriolis=self.in_order(bias - gravity),
            gravity=self.in_order(gravity),
            acceleration=self.in_order(acceleration),
            centers=centers,
        )

    def _jacobian(self, function: Any, number: int) -> FloatArray:
        out = np.zeros((6, self.model.nv))
        function(self.model, self._data, out[:3], out[3:], number)
        return self.in_order(out.T).T

    def in_order(self, values: FloatArray) -> FloatArray:
        """Rows of own degrees of freedom -> rows of the reference's; zero where there is none."""
        out = np.zeros((self.layout.nv, *values.shape[1:]))
        out[self.moving] = values[self._dofs[self.moving]]
        return out


def _facts(
    model: Any, slot: Slot, strength: FloatArray, velocities: Mapping[str, float] | None
) -> JointFacts:
    """What a model, with its actuators, says about a joint; ``strength`` (nv, 2) of them."""
    j = int(np.flatnonzero(model.jnt_dofadr == slot.v.start)[0])
    bounds = None
    if slot.kind in ("hinge", "slide"):
        bounds = np.array([-np.inf, np.inf])
        if model.jnt_limited[j]:
            bounds = np.array(model.jnt_range[j])
    return JointFacts(
        kind=slot.kind,
        range=bounds,
        armature=np.array(model.dof_armature[slot.v]),
        damping=np.array(model.dof_damping[slot.v]),
        friction=np.array(model.dof_frictionloss[slot.v]),
        effort=strength[slot.v],
        velocity=None
        if velocities is None
        else np.full(slot.v.stop - slot.v.start, velocities.get(slot.name, np.inf)),
    )


def _smooth(model: Any) -> Any:
    """A copy without all that makes the dynamics other than smooth and rigid."""
    out = copy(model)
    for bit in _OFF:
        out.opt.disableflags |= int(bit)
    out.opt.enableflags = 0
    out.opt.density = out.opt.viscosity = 0.0
    out.opt.wind[:] = 0.0
    for values in (
        out.dof_dampingpoly,
        out.tendon_damping,
        out.tendon_armature,
        out.body_gravcomp,
    ):
        values[:] = 0.0
    return out


def _pose(position: FloatArray, matrix: FloatArray) -> SE3:
    return SE3(np.array(matrix).reshape(3, 3), np.array(position))
