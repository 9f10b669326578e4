"""``read_pads``: what ideal tactile pads would feel in a simulation, from MuJoCo's contacts.

Exact: ``sim.controllers.sensing`` adds what a sensor does not know. Everything belongs to the
beginning of the step that ended, like all contacts of MuJoCo.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from sim.contacts import NO_FORCE, contact_loads, object_contacts
from sim.controllers.pads import PadReading
from sim.scene import Scene

__all__ = ["read_pads"]


def read_pads(scene: Scene, data: Any, fingers: tuple[str, ...]) -> PadReading:
    """What the pads of some fingers feel after a step."""
    index = {name: k for k, name in enumerate(fingers)}
    n = len(fingers)
    # per finger: normal force; force; and, times normal force, place, normal, sliding and spin
    total = [0.0] * n
    sums = [[0.0] * 13 for _ in range(n)]
    loads = contact_loads(data)
    places, frames = data.contact.pos.tolist(), data.contact.frame.tolist()
    bodies = scene.model.geom_bodyid
    twists: dict[int, list[float]] = {}
    for i, geom, sign in object_contacts(scene, data):
        k = index.get(scene.finger_of_geom[geom])
        if k is None or loads[i][0] <= NO_FORCE:
            continue
        body = int(bodies[geom])
        for b in (body, scene.object_body):
            if b not in twists:
                twists[b] = _twist(scene, data, b)
        twist = [p - q for p, q in zip(twists[scene.object_body], twists[body], strict=True)]
        _add(sums[k], loads[i], places[i], frames[i], sign, twist)
        total[k] += loads[i][0]
    table = np.array(sums).reshape(n, 13)
    each = zip(sums, total, strict=True)
    normal_force = np.array(total)
    weight = np.where(normal_force > 0, normal_force, np.nan)[:, None]
    force, position, normal, sliding = table[:, :12].reshape(n, 4, 3).transpose(1, 0, 2)
    normal = normal / weight
    length = np.sqrt((normal * normal).sum(axis=1, keepdims=True))
    return PadReading(
        normal_force=normal_force,
        force=force,
        position=position / weight,
        normal=normal / np.maximum(length, MIN_LENGTH),
        sliding=sliding / weight,
        spin=np.array([s[12] / press if press > 0 else 0.0 for s, press in each]),
    )


def _add(
    sums: list[float],
    load: list[float],
    at: list[float],
    frame: list[float],
    sign: float,
    twist: list[float],
) -> None:
    """Add a contact to the sums of its finger; plain numbers are cheaper than arrays of three.

    Args:
        sums: Force, then place, normal, sliding and spin times the normal force: written.
        load: Force in the contact's frame, N.
        at: Its place, m.
        frame: Its axes, one after the other.
        sign: 1 where the first axis points into the object, else -1.
        twist: Of the object relative to the finger's body.
    """
    press, t1, t2 = load
    slip = _velocity(twist, at)
    across = slip[0] * frame[0] + slip[1] * frame[1] + slip[2] * frame[2]
    for j in range(3):
        sums[j] += sign * (press * frame[j] + t1 * frame[3 + j] + t2 * frame[6 + j])
        sums[3 + j] += press * at[j]
        sums[6 + j] += press * sign * frame[j]
        sums[9 + j] += press * (slip[j] - across * frame[j])
        sums[12] += press * sign * twist[j] * frame[j]


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


def _velocity(twist: list[float], point: list[float]) -> list[float]:
    """Velocity at a point of a body that moves by a twist."""
    a, b, c, u, v, w = twist
    x, y, z = point
    return [u + b * z - c * y, v + c * x - a * z, w + a * y - b * x]
