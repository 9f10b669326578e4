"""What every step asks of MuJoCo's contacts, as plain numbers: quick.

``Touch``: contacts that are not between hand and object, and collisions of the hand.

``read_pads``: what ideal tactile pads would feel in a simulation, from MuJoCo's contacts.

Forces, places and sliding of contacts on an object, per finger; asked at every step of a closed
loop. Exact: ``sim.sensing.touch`` has senses that know less. Everything belongs to the beginning of
the step that ended, like all contacts of MuJoCo.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import mujoco
import numpy as np

from planner.spatial import FloatArray
from sim.controllers.base import PadReading
from sim.scene.build import HAND_PREFIX, OBJECT, OBSTACLE_PREFIX, TABLE, Scene

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


NO_FORCE = 1e-6
"""Normal force (N) up to which a contact counts as unloaded: what the contact solver leaves."""


def normal_forces(scene: Scene, data: Any, fingers: tuple[str, ...]) -> FloatArray:
    """Sum of normal forces on the object per finger, (n,), N: quick enough for every step."""
    total = [0.0] * len(fingers)
    touching = object_contacts(scene, data)
    if touching:
        finger = scene.finger_numbers(fingers)
        forces, address = data.efc_force, data.contact.efc_address.tolist()
        edges = data.contact.dim.tolist() if scene.pyramids else ()
        for i, geom, _ in touching:
            k, first = finger[geom], address[i]
            if k < 0 or first < 0:
                continue
            if edges and edges[i] > 1:  # the edges' forces add up to the normal force
                total[k] += sum(forces[first : first + 2 * (edges[i] - 1)].tolist())
            else:
                total[k] += forces.item(first)
    return np.array(total)


def load_of(
    forces: Any, address: int, dim: int, friction: Any, pyramids: bool
) -> tuple[float, float, float]:
    """f_n, f_t1, f_t2 (N) of a contact on its geom 2, in MuJoCo's frame: ``mj_contactForce``.

    Args:
        forces: Of all constraints, N.
        address: Where those of the contact begin, negative for a contact without.
        dim: Its dimension: 1, 3, 4 or 6.
        friction: Its five coefficients.
        pyramids: Whether the friction cone is a pyramid, whose edges have a force each; else it is
            elliptic and the constraint's force is the contact's.
    """
    if address < 0:
        return 0.0, 0.0, 0.0
    if dim == 1:
        return forces[address], 0.0, 0.0
    if not pyramids:
        return forces[address], forces[address + 1], forces[address + 2]
    normal = 0.0
    for k in range(2 * (dim - 1)):
        normal += forces[address + k]
    return (
        normal,
        (forces[address] - forces[address + 1]) * friction[0],
        (forces[address + 2] - forces[address + 3]) * friction[1],
    )


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


TouchKind: TypeAlias = Literal[
    "hand-hand", "hand-table", "hand-obstacle", "object-table", "object-obstacle"
]


@dataclass(frozen=True, kw_only=True)
class Touch:
    """A contact that is not between hand and object.

    Attributes:
        kind: Who touches whom.
        first: Geom name without the hand's prefix.
        second: Geom name of the other.
        normal_force: N, >= 0.
    """

    kind: TouchKind
    first: str
    second: str
    normal_force: float


def other_touches(scene: Scene, data: Any) -> list[Touch]:
    """Loaded contacts that are not between hand and object."""
    forces = contact_forces(scene.model, data)[:, 0].tolist()
    return _touches(scene, data.contact.geom.tolist(), forces)


def collisions(
    scene: Scene, geoms: Sequence[Sequence[int]], forces: Sequence[float]
) -> tuple[str, float]:
    """The pair with the largest normal force (N) of hand on table, obstacle or itself; "" and 0.

    Args:
        scene: What the geoms belong to.
        geoms: Pairs of geoms that touch.
        forces: Their normal forces, N.
    """
    hits: dict[str, float] = defaultdict(float)
    for touch in _touches(scene, geoms, forces):
        if touch.kind.startswith("hand"):
            hits[f"{touch.first} - {touch.second}"] += touch.normal_force
    return max(hits.items(), key=lambda hit: hit[1], default=("", 0.0))


def _touches(scene: Scene, geoms: Sequence[Sequence[int]], forces: Sequence[float]) -> list[Touch]:
    """Those of some contacts that are loaded, and not between hand and object."""
    touches = []
    for (first, second), force in zip(geoms, forces, strict=True):
        if force <= NO_FORCE:
            continue
        sides = {_side(scene, first): first, _side(scene, second): second}
        kind = _kind(set(sides))
        if kind is None:
            continue
        pair = [sides[side] for side in kind.split("-")] if len(sides) == 2 else [first, second]
        names = [_name(scene, geom) for geom in pair]
        touches.append(
            Touch(
                kind=kind,
                first=names[0].removeprefix(HAND_PREFIX),
                second=names[1].removeprefix(HAND_PREFIX).removeprefix(OBSTACLE_PREFIX),
                normal_force=force,
            )
        )
    return touches


def _side(scene: Scene, geom: int) -> str:
    if geom in scene.finger_of_geom:
        return "hand"
    body = int(scene.model.geom_bodyid[geom])
    if body == scene.object_body:
        return "object"
    if scene.root_of_body[body] == scene.object_body:
        return "part"  # a lever that moves with the object: pressed, not collided with
    return "table" if scene.model.geom(geom).name == TABLE else "obstacle"


def _name(scene: Scene, geom: int) -> str:
    """Name of a geom; the pieces of an object all bear the object's."""
    if int(scene.model.geom_bodyid[geom]) == scene.object_body:
        return OBJECT
    name: str = scene.model.geom(geom).name
    return name


def _kind(sides: set[str]) -> TouchKind | None:
    kinds: dict[frozenset[str], TouchKind] = {
        frozenset({"hand"}): "hand-hand",
        frozenset({"hand", "table"}): "hand-table",
        frozenset({"hand", "obstacle"}): "hand-obstacle",
        frozenset({"object", "table"}): "object-table",
        frozenset({"object", "obstacle"}): "object-obstacle",
    }
    return kinds.get(frozenset(sides))
