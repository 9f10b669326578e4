"""``read_pads``: what ideal tactile pads would feel in a simulation, from MuJoCo's contacts.

Exact: ``sim.tactile`` has senses that know less. Everything belongs to the beginning of the step
that ended, like all contacts of MuJoCo.
"""

from __future__ import annotations

from typing import Any

from sim.contacts.pad_sums import pad_means, twist_of
from sim.controllers.pads import PadReading
from sim.scene import Scene

__all__ = ["body_twist", "read_pads"]


def read_pads(scene: Scene, data: Any, fingers: tuple[str, ...]) -> PadReading:
    """What the pads of some fingers feel after a step."""
    n, contact = len(fingers), data.contact
    if data.ncon == 0:
        return PadReading.nothing(n)
    # copies, whose memory is laid out alike however many contacts there are
    table = pad_means(
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
    return PadReading(
        normal_force=table[:, 0].copy(),
        force=table[:, 1:4],
        position=table[:, 4:7],
        normal=table[:, 7:10],
        sliding=table[:, 10:13],
        spin=table[:, 13],
    )


def body_twist(scene: Scene, data: Any, body: int) -> list[float]:
    """Angular velocity, and velocity of the body's point at the world's origin; world axes.

    MuJoCo keeps velocities about the centre of mass of the whole tree.
    """
    root = scene.root_of_body[body]
    rows = (data.cvel[body], data.xpos[body], data.subtree_com[root])
    return list(twist_of(*(row.tolist() for row in rows)))
