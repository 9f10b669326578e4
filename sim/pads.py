"""``read_pads``: what ideal tactile pads would feel in a simulation, from MuJoCo's contacts.

Exact: ``sim.controllers.sensing`` adds what a sensor does not know. Everything belongs to the
beginning of the step that ended, like all contacts of MuJoCo.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from sim.contacts.pad_sums import pad_sums, twist_of
from sim.controllers.pads import PadReading
from sim.scene import Scene

__all__ = ["body_twist", "read_pads"]

MIN_LENGTH = 1e-12
"""Least length (-) of a mean of normals that is divided by: a finger that pinches the object by
itself can have none."""


def read_pads(scene: Scene, data: Any, fingers: tuple[str, ...]) -> PadReading:
    """What the pads of some fingers feel after a step."""
    n, contact = len(fingers), data.contact
    table = np.zeros((n, 14))
    if data.ncon > 0:
        # copies, whose memory is laid out alike however many contacts there are
        table = pad_sums(
            contact.geom.copy(),
            contact.pos.copy(),
            contact.frame.copy(),
            contact.efc_address.copy(),
            contact.dim.copy(),
            contact.friction.copy(),
            data.efc_force.copy(),
            scene.pyramids,
            data.cvel,
            data.xpos,
            data.subtree_com,
            scene.finger_numbers(fingers),
            scene.is_object_geom,
            scene.model.geom_bodyid,
            scene.model.body_rootid,
            scene.object_body,
            n,
        )
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


def body_twist(scene: Scene, data: Any, body: int) -> list[float]:
    """Angular velocity, and velocity of the body's point at the world's origin; world axes.

    MuJoCo keeps velocities about the centre of mass of the whole tree.
    """
    root = scene.root_of_body[body]
    rows = (data.cvel[body], data.xpos[body], data.subtree_com[root])
    return list(twist_of(*(row.tolist() for row in rows)))
