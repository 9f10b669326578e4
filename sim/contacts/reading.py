"""What every step asks of MuJoCo's contacts, as plain numbers: quick.

``Touch``: contacts that are not between hand and object, and collisions of the hand.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import mujoco
import numpy as np

from planner.spatial import FloatArray
from sim.scene import HAND_PREFIX, OBJECT, OBSTACLE_PREFIX, TABLE, Scene

NO_FORCE = 1e-6
"""Normal force (N) up to which a contact counts as unloaded: what the contact solver leaves."""


_PYRAMID = int(mujoco.mjtConstraint.mjCNSTR_CONTACT_PYRAMIDAL)


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


def contact_loads(data: Any) -> list[list[float]]:
    """f_n, f_t1, f_t2 (N) of every contact on its geom 2, in MuJoCo's frame, as plain numbers.

    What ``mj_contactForce`` gives, all at once.
    """
    forces, kinds = data.efc_force.tolist(), data.efc_type
    out, contact = [], data.contact
    columns = (contact.efc_address, contact.dim, contact.friction)
    for address, dim, friction in zip(*(column.tolist() for column in columns), strict=True):
        pyramids = address >= 0 and kinds[address] == _PYRAMID
        out.append(list(load_of(forces, address, dim, friction, pyramids)))
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
    if int(scene.model.geom_bodyid[geom]) == scene.object_body:
        return "object"
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
