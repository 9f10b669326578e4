"""``read_pads``: what ideal tactile pads would feel in a simulation, from MuJoCo's contacts.

Exact: ``sim.tactile`` has senses that know less. Everything belongs to the beginning of the step
that ended, like all contacts of MuJoCo.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from sim.contacts import NO_FORCE, contact_loads, object_contacts
from sim.controllers.pads import PadReading
from sim.scene import Scene

__all__ = ["body_twist", "read_pads"]

MIN_LENGTH = 1e-12
"""Least length (-) of a mean of normals that is divided by: a finger that pinches the object by
itself can have none."""


def read_pads(scene: Scene, data: Any, fingers: tuple[str, ...]) -> PadReading:
    """What the pads of some fingers feel after a step."""
    index = {name: k for k, name in enumerate(fingers)}
    n = len(fingers)
    # per finger: normal force; force; and, times normal force, place, normal, sliding and spin
    sums = [[0.0] * 14 for _ in range(n)]
    touching = object_contacts(scene, data)
    if touching:
        loads, of_object = contact_loads(data), body_twist(scene, data, scene.object_body)
        places, frames = data.contact.pos.tolist(), data.contact.frame.tolist()
        twists: dict[int, list[float]] = {}
        for i, geom, sign in touching:
            k = index.get(scene.finger_of_geom[geom])
            if k is None or loads[i][0] <= NO_FORCE:
                continue
            body = scene.body_of_geom[geom]
            if body not in twists:
                twists[body] = [
                    p - q for p, q in zip(of_object, body_twist(scene, data, body), strict=True)
                ]
            _add(sums[k], loads[i], places[i], frames[i], sign, twists[body])
    table = np.array(sums).reshape(n, 14)
    normal_force = table[:, 0].copy()
    pressing = normal_force > 0
    weight = np.where(pressing, normal_force, np.nan)[:, None]
    force, position, normal, sliding = table[:, 1:13].reshape(n, 4, 3).transpose(1, 0, 2)
    normal = normal / weight
    length = np.sqrt((normal * normal).sum(axis=1, keepdims=True))
    return PadReading(
        normal_force=normal_force,
        force=force,
        position=position / weight,
        normal=normal / np.maximum(length, MIN_LENGTH),
        sliding=sliding / weight,
        spin=np.where(pressing, table[:, 13] / np.where(pressing, normal_force, 1.0), 0.0),
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
        sums: Normal force, force; then place, normal, sliding and spin times the normal force:
            written.
        load: Force in the contact's frame, N.
        at: Its place, m.
        frame: Its axes, one after the other.
        sign: 1 where the first axis points into the object, else -1.
        twist: Of the object relative to the finger's body: angular velocity, and velocity of the
            point at the world's origin.
    """
    press, t1, t2 = load
    x, y, z = at
    a, b, c, u, v, w = twist
    n0, n1, n2, p0, p1, p2, q0, q1, q2 = frame
    s0, s1, s2 = u + b * z - c * y, v + c * x - a * z, w + a * y - b * x
    across = s0 * n0 + s1 * n1 + s2 * n2
    inward = press * sign
    sums[0] += press
    sums[1] += sign * (press * n0 + t1 * p0 + t2 * q0)
    sums[2] += sign * (press * n1 + t1 * p1 + t2 * q1)
    sums[3] += sign * (press * n2 + t1 * p2 + t2 * q2)
    sums[4] += press * x
    sums[5] += press * y
    sums[6] += press * z
    sums[7] += inward * n0
    sums[8] += inward * n1
    sums[9] += inward * n2
    sums[10] += press * (s0 - across * n0)
    sums[11] += press * (s1 - across * n1)
    sums[12] += press * (s2 - across * n2)
    sums[13] += inward * a * n0
    sums[13] += inward * b * n1
    sums[13] += inward * c * n2


def body_twist(scene: Scene, data: Any, body: int) -> list[float]:
    """Angular velocity, and velocity of the body's point at the world's origin; world axes.

    MuJoCo keeps velocities about the centre of mass of the whole tree.
    """
    a, b, c, u, v, w = data.cvel[body].tolist()
    x, y, z = data.xpos[body].tolist()
    cx, cy, cz = data.subtree_com[scene.root_of_body[body]].tolist()
    x0, y0, z0 = x - cx, y - cy, z - cz
    u, v, w = u - (y0 * c - z0 * b), v - (z0 * a - x0 * c), w - (x0 * b - y0 * a)
    return [a, b, c, u - b * z + c * y, v - c * x + a * z, w - a * y + b * x]
