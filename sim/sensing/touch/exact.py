"""``exact_images``: what perfect taxels would read in a simulation, from MuJoCo's contacts.

Every contact of a pad's geom counts, whatever touches it, as it would on a real pad. Called once a
time step by the sense ``taxels``; everything belongs to the beginning of the step that ended.

How pressure and shear are spread over a pad: the one place, and its sources.

MuJoCo's contacts are points with a force; a soft pad spreads it. Of each contact

    radius      a = (3 f R / 4 E)^(1/3): Hertz, a sphere of radius R on a flat body, with the
                contact modulus E = 1.3 MPa of soft rubber
    pressure    a Gaussian of Hertz's second moment, sigma^2 = a^2 / 5 on each axis, integrated
                over the cell of each taxel: what lies on the array is conserved
    shear       Cattaneo and Mindlin: a share (used) of the friction cone in use sticks within
                c = a (1 - used)^(1/3) and slips outside, so that the shear is that of full
                slip with radius a less (1 - used) of that with radius c, over used
    torsion     a shear that grows with the distance from the middle

K. L. Johnson, Contact Mechanics, Cambridge 1985: 3.4 and 4.2 (Hertz), 7.2 (Cattaneo, Mindlin).
The object counts as flat and rigid: one that is round has a smaller patch. The shear at full slip
is mu times the pressure everywhere, so its spread tells how much of the friction is in use before
anything slides. Torsion and force use the cone together, as MuJoCo's contacts do.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import erf

from planner.spatial import FloatArray
from sim.contacts import NO_FORCE
from sim.controllers import TouchReading
from sim.scene.build import HAND_PREFIX, Scene
from sim.sensing.touch.layout import TaxelLayout, Texture

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
    scene.task.require_fingertips("touch by taxels")
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


CONTACT_MODULUS = 1.3e6
"""Contact modulus E / (1 - nu^2) of pads, Pa: the soft rubber of ``sim.scene.physics``."""

LEAST_DEVIATION = 1e-4
"""Standard deviation (m) of the pressure of the lightest touch: pads are no sharper than 0.1 mm."""

LEAST_USED = 0.02
"""Share of friction (-) below which the shear has the spread of this share: the formula is 0/0."""

LEAST_SPREAD = 1e-30
"""Share (-) that is as good as none: its logarithm is finite."""

_ROOT, _DENSITY = math.sqrt(0.5), 1.0 / math.sqrt(2.0 * math.pi)


def contact_deviation(force: float, radius: float) -> float:
    """Standard deviation (m), each axis, of the pressure of a normal force.

    Args:
        force: N, >= 0.
        radius: Of the pad, m.
    """
    patch = math.cbrt(0.75 * force * radius / CONTACT_MODULUS)
    return max(patch / math.sqrt(5.0), LEAST_DEVIATION)


def spread(
    edges: FloatArray, middle: float | FloatArray, deviation: float | FloatArray
) -> FloatArray:
    """Shares (..., n) of a Gaussian within n neighbouring cells.

    Args:
        edges: Their borders, (..., n + 1), m.
        middle: Of the Gaussian, m; a number, or one that broadcasts.
        deviation: Its standard deviation, m; likewise.
    """
    below = erf((_ROOT / deviation) * (edges - middle))
    return np.asarray(0.5 * (below[..., 1:] - below[..., :-1]))


def spread_with_slopes(
    edges: FloatArray, middle: FloatArray, deviation: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Logarithms of the shares (..., n) that ``spread`` gives, and how they grow (..., n), (-).

    The second is with the middle, per deviation of the Gaussian; the third with the logarithm of
    the deviation. Shares are at least ``LEAST_SPREAD``.
    """
    z = (edges - middle) / deviation
    below = 0.5 * erf(_ROOT * z)
    density = _DENSITY * np.exp(-0.5 * z * z)
    moment = z * density
    shares = np.maximum(below[..., 1:] - below[..., :-1], LEAST_SPREAD)
    slopes = (density[..., :-1] - density[..., 1:]) / shares
    widths = (moment[..., :-1] - moment[..., 1:]) / shares
    return np.log(shares), slopes, widths


def spread_of_shear(pressure: FloatArray, stuck: FloatArray, used: float) -> FloatArray:
    """Shares of the shear force per taxel.

    Args:
        pressure: Shares of the normal force.
        stuck: The same with the deviation of the stick region.
        used: Share of the friction cone in use (-).
    """
    used = min(1.0, max(used, LEAST_USED))
    return np.asarray((pressure - (1.0 - used) * stuck) / used)


def stick_ratio(used: float) -> float:
    """Radius of the stick region over that of the patch (-), at a share of friction in use."""
    return math.cbrt(1.0 - min(1.0, max(used, LEAST_USED)))
