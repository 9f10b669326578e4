"""What MuJoCo says about the strength of joints and the inertia of bodies, for a cross-check."""

from __future__ import annotations

from copy import copy
from typing import Any

import mujoco
import numpy as np

from planner.spatial import FloatArray
from sim.crosscheck.parts import LinkInertia

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
