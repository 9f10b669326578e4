"""``read_pads``: what ideal tactile pads would feel in a simulation, from MuJoCo's contacts.

Forces, places and sliding of contacts on an object, per finger; asked at every step of a closed
loop. Exact: ``sim.tactile`` has senses that know less. Everything belongs to the beginning of the
step that ended, like all contacts of MuJoCo.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from sim.contacts.reading import NO_FORCE, load_of, object_contacts
from sim.controllers.readings import PadReading
from sim.scene import Scene

MIN_LENGTH = 1e-12
"""Least length (-) of a mean of normals that is divided by: a finger that pinches the object by
itself can have none."""


def _add(sums: Any, load: Any, at: Any, frame: Any, sign: float, twist: Any) -> None:
    """Add a contact to the sums of its finger.

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
    press, t1, t2 = load[0], load[1], load[2]
    x, y, z = at[0], at[1], at[2]
    a, b, c, u, v, w = twist[0], twist[1], twist[2], twist[3], twist[4], twist[5]
    n0, n1, n2, p0, p1, p2 = frame[0], frame[1], frame[2], frame[3], frame[4], frame[5]
    q0, q1, q2 = frame[6], frame[7], frame[8]
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


def read_pads(scene: Scene, data: Any, fingers: tuple[str, ...]) -> PadReading:
    """What the pads of some fingers feel after a step."""
    n, contact = len(fingers), data.contact
    if data.ncon == 0:
        return PadReading.nothing(n)
    finger = scene.finger_numbers(fingers)
    # plain numbers are cheaper than arrays of three
    sums, forces = [[0.0] * 14 for _ in range(n)], data.efc_force.tolist()
    columns = (contact.pos, contact.frame, contact.efc_address, contact.dim, contact.friction)
    places, frames, addresses, dims, friction = (column.tolist() for column in columns)
    moving: dict[int, list[float]] = {}
    for i, geom, sign in object_contacts(scene, data):
        k = int(finger[geom])
        load = load_of(forces, addresses[i], dims[i], friction[i], scene.pyramids)
        if k < 0 or load[0] <= NO_FORCE:
            continue
        body = scene.body_of_geom[geom]
        if body not in moving:
            pair = [body_twist(scene, data, b) for b in (scene.object_body, body)]
            moving[body] = [p - q for p, q in zip(*pair, strict=True)]
        _add(sums[k], load, places[i], frames[i], sign, moving[body])
    table = np.array(sums).reshape(n, 14)
    pressing = table[:, 0] > 0
    weight = np.where(pressing, table[:, 0], np.nan)[:, None]
    spin = np.where(pressing, table[:, 13] / np.where(pressing, table[:, 0], 1.0), 0.0)
    means = table[:, 4:13] / weight
    normal = means[:, 3:6]
    length = np.sqrt((normal * normal).sum(axis=1, keepdims=True))
    return PadReading(
        normal_force=table[:, 0].copy(),
        force=table[:, 1:4],
        position=means[:, :3],
        normal=normal / np.maximum(length, MIN_LENGTH),
        sliding=means[:, 6:],
        spin=spin,
    )


def body_twist(scene: Scene, data: Any, body: int) -> list[float]:
    """Angular velocity, and velocity of the body's point at the world's origin; world axes.

    MuJoCo keeps velocities about the centre of mass of the whole tree.
    """
    center = data.subtree_com[scene.root_of_body[body]].tolist()
    a, b, c, u, v, w = data.cvel[body].tolist()
    x, y, z = data.xpos[body].tolist()
    x0, y0, z0 = x - center[0], y - center[1], z - center[2]
    u, v, w = u - (y0 * c - z0 * b), v - (z0 * a - x0 * c), w - (x0 * b - y0 * a)
    return [a, b, c, u - b * z + c * y, v - c * x + a * z, w - a * y + b * x]
