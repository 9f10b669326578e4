"""What every step asks of MuJoCo's contacts, as plain numbers: quick."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from planner.spatial import FloatArray
from sim.scene import Scene

__all__ = ["NO_FORCE", "contact_forces", "contact_loads", "normal_forces", "object_contacts"]

NO_FORCE = 1e-6
"""Normal force (N) up to which a contact counts as unloaded: what the contact solver leaves."""


def normal_forces(scene: Scene, data: Any, fingers: tuple[str, ...]) -> FloatArray:
    """Sum of normal forces on the object per finger, (n,), N: quick enough for every step."""
    total = [0.0] * len(fingers)
    touching = object_contacts(scene, data)
    if touching:
        place = {name: k for k, name in enumerate(fingers)}
        finger_of_geom = scene.finger_of_geom
        forces, address = data.efc_force, data.contact.efc_address.tolist()
        for i, geom, _ in touching:
            k = place.get(finger_of_geom[geom])
            if k is not None and address[i] >= 0:
                total[k] += float(forces[address[i]])
    return np.array(total)


def contact_loads(data: Any) -> list[list[float]]:
    """f_n, f_t1, f_t2 (N) of every contact on its geom 2, in MuJoCo's frame, as plain numbers.

    What ``mj_contactForce`` gives, all at once: with elliptic cones, which scenes have, it is the
    constraint force itself.
    """
    forces = data.efc_force.tolist()
    out = []
    for address, dim in zip(
        data.contact.efc_address.tolist(), data.contact.dim.tolist(), strict=True
    ):
        load = forces[address : address + min(dim, 3)] if address >= 0 else []
        out.append(load + [0.0] * (3 - len(load)))
    return out


def object_contacts(scene: Scene, data: Any) -> list[tuple[int, int, float]]:
    """Every contact of hand and object: its number, the hand's geom, and a sign.

    The sign is 1 where MuJoCo's normal points into the object, else -1; times the force that
    ``mj_contactForce`` gives, turned into the world, it makes the force on the object.
    """
    if data.ncon == 0:
        return []
    out = []
    hand, of_object = scene.finger_of_geom, scene.object_geoms
    for i, (first, second) in enumerate(data.contact.geom.tolist()):
        if first in of_object:
            if second in hand:
                out.append((i, second, -1.0))
        elif second in of_object and first in hand:
            out.append((i, first, 1.0))
    return out


def contact_forces(model: Any, data: Any) -> FloatArray:
    """f_n, f_t1, f_t2 (N) and tau_n (N m) of every contact on geom 2, (ncon, 4), one by one."""
    forces, one = np.zeros((data.ncon, 4)), np.zeros(6)
    for i in range(data.ncon):
        mujoco.mj_contactForce(model, data, i, one)
        forces[i] = one[:4]
    return forces
