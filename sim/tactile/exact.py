"""``exact_images``: what perfect taxels would read in a simulation, from MuJoCo's contacts.

Every contact of a pad's geom counts, whatever touches it, as it would on a real pad. Called once a
time step by the sense ``taxels``; everything belongs to the beginning of the step that ended.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from planner.spatial import FloatArray
from sim.contacts import NO_FORCE
from sim.controllers import TouchReading
from sim.scene import HAND_PREFIX, Scene
from sim.tactile.layout import TaxelLayout
from sim.tactile.pressure import contact_deviation, spread, spread_of_shear, stick_ratio
from sim.tactile.texture import Texture

NO_SHARE = 1e-9
"""Share of a force (-) on the array below which it lies beside it."""

LEAST_ARM = 0.1
"""Mean square of the taxels' distance from the contact over that of its patch (-), below which a
torsion is not felt in full: a patch on a single taxel has no arm to turn by."""


@dataclass(frozen=True, kw_only=True)
class PadContact:
    """A loaded contact of a pad, in the frame of the pad's body.

    Attributes:
        point: (3,), m.
        normal: (3,), unit, outward.
        normal_force: N.
        shear: (3,), N, on what touches, along the surface.
        torsion: N m, on what touches, about the normal.
        used: Share of the friction cone in use (-).
    """

    point: FloatArray
    normal: FloatArray
    normal_force: float
    shear: FloatArray
    torsion: float
    used: float


def layouts_of(scene: Scene, fingers: Sequence[str]) -> tuple[TaxelLayout, ...]:
    """The arrays of some fingers, in their order."""
    described = {f.name: f for f in scene.task.hand.description.fingers}
    return tuple(TaxelLayout.of(described[name]) for name in fingers)


def pad_contacts(scene: Scene, data: Any, layouts: Sequence[TaxelLayout]) -> list[list[PadContact]]:
    """The loaded contacts of each pad."""
    out: list[list[PadContact]] = [[] for _ in layouts]
    if data.ncon == 0:
        return out
    pad_of = {int(scene.model.geom(HAND_PREFIX + one.geom).id): k for k, one in enumerate(layouts)}
    addresses, dims = data.contact.efc_address, data.contact.dim
    for i, (first, second) in enumerate(data.contact.geom.tolist()):
        for geom, sign in ((first, 1.0), (second, -1.0)):
            k, address = pad_of.get(geom), int(addresses[i])
            if k is None or address < 0:
                continue
            # with elliptic cones, which scenes have, forces stand as they are
            load = np.zeros(4)
            dim = min(int(dims[i]), 4)
            load[:dim] = data.efc_force[address : address + dim]
            if load[0] <= NO_FORCE:
                continue
            contact = data.contact[i]
            out[k].append(_in_pad(scene, data, geom, sign, contact, load))
    return out


def _in_pad(
    scene: Scene, data: Any, geom: int, sign: float, contact: Any, load: FloatArray
) -> PadContact:
    body = scene.body_of_geom[geom]
    turn = data.xmat[body].reshape(3, 3).T
    axes = contact.frame.reshape(3, 3) @ turn.T
    friction = contact.friction
    slide = math.hypot(load[1], load[2]) / max(friction[0], 1e-9)
    twist = load[3] / max(friction[2], 1e-9)
    return PadContact(
        point=turn @ (contact.pos - data.xpos[body]),
        normal=sign * axes[0],
        normal_force=float(load[0]),
        shear=sign * (load[1] * axes[1] + load[2] * axes[2]),
        torsion=float(load[3]),
        used=min(1.0, math.hypot(slide, twist) / float(load[0])),
    )


def contact_image(
    layout: TaxelLayout, contact: PadContact, gains: FloatArray | None = None
) -> FloatArray:
    """What perfect taxels read of one contact, (rows, columns, 3), N; see ``TouchReading``.

    Args:
        layout: The array.
        contact: The contact.
        gains: (rows, columns), of the texture under each taxel (-); a smooth object if None.
    """
    place = layout.chart(contact.point)
    deviation = contact_deviation(contact.normal_force, layout.radius)
    across, along = layout.edges
    sizes = np.array([[deviation], [max(stick_ratio(contact.used), 0.05) * deviation]])
    in_rows, in_columns = spread(along, place[1], sizes), spread(across, place[0], sizes)
    pressure, stuck = in_rows[:, :, None] * in_columns[:, None, :]
    shear = spread_of_shear(pressure, stuck, contact.used)
    if gains is not None:
        pressure, shear = _textured(np.stack([pressure, shear]), gains)
    forces = [(contact.normal, contact.normal_force * pressure), (contact.shear, shear)]
    if contact.torsion:
        frame = layout.frame_at(place)
        by_column, by_row = pressure.sum(axis=0), pressure.sum(axis=1)
        felt = max(float(by_row.sum()), NO_SHARE)
        # about the centroid of what is felt, so that a torsion adds no force
        du = (layout.u - by_column @ layout.u / felt)[None, :]
        dv = (layout.v - by_row @ layout.v / felt)[:, None]
        square = float(by_column @ du[0] ** 2 + by_row @ dv[:, 0] ** 2) / felt
        least = LEAST_ARM * (2.0 * deviation**2 + layout.array.spacing**2 / 6.0)
        turned = contact.torsion / max(square, least) * pressure
        forces += [(frame[:, 2], turned * du), (-frame[:, 1], turned * dv)]
    vectors, amounts = (np.array(part) for part in zip(*forces, strict=True))
    in_body = (amounts.reshape(len(vectors), -1).T @ vectors).reshape(*layout.shape, 3)
    return np.asarray(np.einsum("rcik,rci->rck", layout.frames, in_body))


def _textured(shares: FloatArray, gains: FloatArray) -> FloatArray:
    """Shares (n, rows, columns) of n forces with the gains of a texture; their sums stay."""
    changed = shares * gains
    sums, before = changed.sum(axis=(1, 2)), shares.sum(axis=(1, 2))
    kept = np.abs(sums) < NO_SHARE
    factors = np.where(kept, 1.0, before / np.where(kept, 1.0, sums))
    return np.asarray(changed * factors[:, None, None])


def exact_images(
    scene: Scene,
    data: Any,
    layouts: Sequence[TaxelLayout],
    textures: Sequence[Texture] | None = None,
) -> tuple[FloatArray, ...]:
    """What perfect arrays read, one image (rows, columns, 3) per layout, N.

    Args:
        scene: The scene.
        data: ``mujoco.MjData``.
        layouts: The arrays.
        textures: What lies under each of them; smooth objects if None.
    """
    out = []
    for k, contacts in enumerate(pad_contacts(scene, data, layouts)):
        image = np.zeros((*layouts[k].shape, 3))
        gains = None if textures is None else textures[k].gains
        for contact in contacts:
            image += contact_image(layouts[k], contact, gains)
        out.append(image)
    return tuple(out)


def read_touch(scene: Scene, data: Any, fingers: Sequence[str]) -> TouchReading:
    """What perfect arrays of some fingers read now."""
    images = exact_images(scene, data, layouts_of(scene, fingers))
    return TouchReading(time=np.full(len(images), float(data.time)), images=images)
