"""``read_pads``: what ideal tactile pads would feel in a simulation, from MuJoCo's contacts.

Exact: ``sim.controllers.sensing`` adds what a sensor does not know. Everything belongs to the
beginning of the step that ended, like all contacts of MuJoCo.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from planner.spatial import FloatArray
from sim.contacts import NO_FORCE, object_contacts
from sim.controllers.pads import PadReading
from sim.scene import Scene

__all__ = ["read_pads"]


def read_pads(scene: Scene, data: Any, fingers: tuple[str, ...]) -> PadReading:
    """What the pads of some fingers feel after a step."""
    index = {name: k for k, name in enumerate(fingers)}
    found: list[tuple[int, int, float, int]] = []
    twists: dict[int, FloatArray] = {}
    loads: list[FloatArray] = []
    for i, geom, sign in object_contacts(scene, data):
        k = index.get(scene.finger_of_geom[geom])
        if k is None:
            continue
        load = np.zeros(6)
        mujoco.mj_contactForce(scene.model, data, i, load)
        if load[0] <= NO_FORCE:
            continue
        body = int(scene.model.geom_bodyid[geom])
        if body not in twists:
            twists[body] = _twist(scene, data, body)
        found.append((i, body, sign, k))
        loads.append(load[:3])
    n = len(fingers)
    if not found:
        return PadReading.nothing(n)
    contact, bodies, signs, finger = zip(*found, strict=True)
    sign = np.array(signs)[:, None]
    frames = data.contact.frame[list(contact)].reshape(-1, 3, 3)
    at = data.contact.pos[list(contact)]
    load = np.array(loads)
    into = sign * frames[:, 0]
    slip = _at(_twist(scene, data, scene.object_body), at) - _at(
        np.array([twists[body] for body in bodies]), at
    )
    slip -= (slip * into).sum(axis=1, keepdims=True) * into
    share = np.zeros((n, len(found)))  # normal forces, one row per finger
    share[list(finger), range(len(found))] = load[:, 0]
    total = share.sum(axis=1)
    mean = share / np.where(total > 0, total, np.nan)[:, None]
    normal = mean @ into
    length = np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), MIN_LENGTH)
    return PadReading(
        normal_force=total,
        force=(share > 0) @ (sign * np.einsum("mi,mij->mj", load, frames)),
        position=mean @ at,
        normal=normal / length,
        sliding=mean @ slip,
    )


MIN_LENGTH = 1e-12
"""Least length (-) of a mean of normals that is divided by: a finger that pinches the object by
itself can have none."""


def _twist(scene: Scene, data: Any, body: int) -> FloatArray:
    """[angular velocity; velocity of the body's point at the world's origin], (6,), world axes."""
    twist = np.zeros(6)
    kind = int(mujoco.mjtObj.mjOBJ_XBODY)
    mujoco.mj_objectVelocity(scene.model, data, kind, body, twist, 0)
    twist[3:] -= _cross(twist[:3], data.xpos[body])
    return twist


def _at(twist: FloatArray, points: FloatArray) -> FloatArray:
    """Velocities (m, 3) of points (m, 3) that move with twists (6,) or (m, 6)."""
    return np.asarray(twist[..., 3:] + _cross(twist[..., :3], points))


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Cross product, without the overhead of ``np.cross``."""
    turned = a[..., [1, 2, 0]] * b[..., [2, 0, 1]] - a[..., [2, 0, 1]] * b[..., [1, 2, 0]]
    return np.asarray(turned)
