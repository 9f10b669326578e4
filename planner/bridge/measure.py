"""MuJoCo at one configuration of a model: body positions, contacts, distances, inertias."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from planner.spatial import FloatArray

FURTHEST = 1.0
"""Largest distance (m) that MuJoCo measures between two geoms."""


def joint_inertia(model: Any, q: FloatArray) -> FloatArray:
    """Diagonal (nv,) of the mass matrix at q (nv,), kg m^2 (kg): the inertia at each servo."""
    data = mujoco.MjData(model)
    data.qpos[:] = q
    mujoco.mj_forward(model, data)
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    return np.diag(full).copy()


def body_positions(model: Any, q: FloatArray) -> FloatArray:
    """Positions (nbody, 3) of all bodies at q (nq,) by MuJoCo's kinematics, m."""
    data = mujoco.MjData(model)
    data.qpos[:] = q
    mujoco.mj_kinematics(model, data)
    return np.array(data.xpos)


def touching_geoms(model: Any, q: FloatArray) -> tuple[tuple[str, str, float], ...]:
    """Pairs of geoms that MuJoCo finds in contact at q (nq,), with the signed distance, m."""
    data = mujoco.MjData(model)
    data.qpos[:] = q
    mujoco.mj_forward(model, data)
    nearest: dict[tuple[str, str], float] = {}
    for i in range(data.ncon):
        contact = data.contact[i]
        names = sorted(model.geom(int(g)).name for g in contact.geom)
        pair = (names[0], names[1])
        nearest[pair] = min(nearest.get(pair, np.inf), float(contact.dist))
    return tuple((a, b, d) for (a, b), d in nearest.items())


def geom_distance(model: Any, q: FloatArray, first: str, second: str) -> float:
    """Signed distance of two geoms at q (nq,) by MuJoCo, m; at most ``FURTHEST``."""
    data = mujoco.MjData(model)
    data.qpos[:] = q
    mujoco.mj_forward(model, data)
    ids = model.geom(first).id, model.geom(second).id
    return float(mujoco.mj_geomDistance(model, data, *ids, FURTHEST, None))
