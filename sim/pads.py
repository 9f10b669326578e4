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
    found, loads, slips, spins, signs, finger = [], [], [], [], [], []
    twists: dict[int, list[float]] = {}
    for i, geom, sign in object_contacts(scene, data):
        k = index.get(scene.finger_of_geom[geom])
        load = np.zeros(6)
        mujoco.mj_contactForce(scene.model, data, i, load)
        if k is None or load[0] <= NO_FORCE:
            continue
        body = int(scene.model.geom_bodyid[geom])
        for b in (body, scene.object_body):
            if b not in twists:
                twists[b] = _twist(scene, data, b)
        found.append(i)
        loads.append(load[:3])
        twist = [p - q for p, q in zip(twists[scene.object_body], twists[body], strict=True)]
        slips.append(_velocity(twist, data.contact[i].pos))
        spins.append(twist[:3])
        signs.append(sign)
        finger.append(k)
    n = len(fingers)
    if not found:
        return PadReading.nothing(n)
    sign_column = np.array(signs)[:, None]
    frames = data.contact.frame[found].reshape(-1, 3, 3)
    load_rows, slip = np.array(loads), np.array(slips)
    into = sign_column * frames[:, 0]
    slip -= (slip * into).sum(axis=1, keepdims=True) * into
    share = np.zeros((n, len(found)))  # normal forces, one row per finger
    share[finger, range(len(found))] = load_rows[:, 0]
    total = share.sum(axis=1)
    mean = share / np.where(total > 0, total, np.nan)[:, None]
    normal = mean @ into
    length = np.maximum(np.sqrt((normal * normal).sum(axis=1, keepdims=True)), MIN_LENGTH)
    return PadReading(
        normal_force=total,
        force=(share > 0) @ (sign_column * (load_rows[:, None] @ frames)[:, 0]),
        position=mean @ data.contact.pos[found],
        normal=normal / length,
        sliding=mean @ slip,
        spin=np.nan_to_num(mean @ (np.array(spins) * into).sum(axis=1)),
    )


MIN_LENGTH = 1e-12
"""Least length (-) of a mean of normals that is divided by: a finger that pinches the object by
itself can have none."""


def _twist(scene: Scene, data: Any, body: int) -> list[float]:
    """Angular velocity, and velocity of the body's point at the world's origin; world axes."""
    twist = np.zeros(6)
    kind = int(mujoco.mjtObj.mjOBJ_XBODY)
    mujoco.mj_objectVelocity(scene.model, data, kind, body, twist, 0)
    x, y, z = data.xpos[body].tolist()
    a, b, c, u, v, w = twist.tolist()  # plain numbers: cheaper than arrays of three
    return [a, b, c, u - b * z + c * y, v - c * x + a * z, w - a * y + b * x]


def _velocity(twist: list[float], point: FloatArray) -> list[float]:
    """Velocity at a point (3,) of a body that moves by a twist."""
    a, b, c, u, v, w = twist
    x, y, z = point.tolist()
    return [u + b * z - c * y, v + c * x - a * z, w + a * y - b * x]
