"""MuJoCo's contacts as a ``ContactSet``, so that execution is judged by the code that planned it.

MuJoCo's conventions and what becomes of them:

  - ``contact.frame`` holds [normal, t1, t2] in its ROWS, the normal points from geom 1 to geom 2.
    Where the object is geom 1 the normal is turned round, and t1 with it, so that the frame stays
    right-handed and the normal points into the object.
  - ``mj_contactForce`` gives the force on geom 2 in that frame. On geom 1 it is the opposite: in
    the turned frame its normal and t1 components and its torsional torque keep their values, and
    its t2 component changes sign.
  - condim 1, 3, 4 are "frictionless", "point" and "soft"; condim 6 is read as "soft", its rolling
    part left out.

Forces belong to the positions of the same step: after ``mj_step`` both are those at its beginning.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal, TypeAlias

import mujoco
import numpy as np

from planner.contacts import Contact, ContactModel, ContactSet
from planner.spatial import FloatArray
from planner.task import GraspTask
from sim.scene import HAND_PREFIX, OBJECT, OBSTACLE_PREFIX, TABLE, Scene

__all__ = [
    "Touch",
    "as_believed",
    "contact_loads",
    "contacts_from_mujoco",
    "hand_collision",
    "hand_contacts",
    "merge_per_finger",
    "normal_forces",
    "object_contacts",
    "other_touches",
]

TouchKind: TypeAlias = Literal[
    "hand-hand", "hand-table", "hand-obstacle", "object-table", "object-obstacle"
]

_MODEL: dict[int, ContactModel] = {1: "frictionless", 3: "point", 4: "soft", 6: "soft"}

NO_FORCE = 1e-6
"""Normal force (N) up to which a contact counts as unloaded: what the contact solver leaves."""


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


def contacts_from_mujoco(
    model: Any,
    data: Any,
    *,
    object_body: int,
    finger_of_geom: Mapping[int, str],
    with_unloaded: bool = False,
) -> ContactSet:
    """Contacts between a hand and an object, in the world, with the forces on the object.

    Args:
        model: ``mujoco.MjModel``.
        data: ``mujoco.MjData`` after a step.
        object_body: Body id of the object; its centre of mass becomes the set's centre.
        finger_of_geom: Geom ids of the hand, with the finger each belongs to ("" for none).
        with_unloaded: Also contacts without force, which lie inside the margin.

    Returns:
        The contacts in MuJoCo's order, not merged.
    """
    found = []
    for i, hand_geom, object_first in _pairs(model, data, object_body, finger_of_geom):
        contact = data.contact[i]
        force = _force(model, data, i)
        if force[0] <= NO_FORCE and not with_unloaded:
            continue
        frame = np.array(contact.frame).reshape(3, 3).T
        if object_first:
            frame[:, :2] *= -1.0
            force[2] *= -1.0
        found.append(
            Contact(
                position=np.array(contact.pos),
                frame=frame,
                model=_MODEL[int(contact.dim)],
                mu=float(contact.friction[0]),
                mu_torsion=float(contact.friction[2]) if contact.dim >= 4 else 0.0,
                force=force,
                finger=finger_of_geom[hand_geom],
            )
        )
    return ContactSet.from_contacts(found, center=np.array(data.xipos[object_body]))


def hand_contacts(scene: Scene, data: Any) -> ContactSet:
    """Loaded contacts between a scene's hand and its object, in the world, not merged."""
    return contacts_from_mujoco(
        scene.model,
        data,
        object_body=scene.object_body,
        finger_of_geom=scene.finger_of_geom,
    )


def normal_forces(scene: Scene, data: Any, fingers: tuple[str, ...]) -> FloatArray:
    """Sum of normal forces on the object per finger, (n,), N: quick enough for every step."""
    total = [0.0] * len(fingers)
    index = {name: k for k, name in enumerate(fingers)}
    loads = contact_loads(data)
    for i, geom, _ in _pairs(scene.model, data, scene.object_body, scene.finger_of_geom):
        k = index.get(scene.finger_of_geom[geom])
        if k is not None:
            total[k] += loads[i][0]
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
    pairs = _pairs(scene.model, data, scene.object_body, scene.finger_of_geom)
    return [(i, geom, -1.0 if object_first else 1.0) for i, geom, object_first in pairs]


def as_believed(contacts: ContactSet, task: GraspTask) -> ContactSet:
    """Measured contacts under the friction and the contact model that planning relies on.

    What simulation has beside that, more friction and torsion, is no part of it.
    """
    believed = contacts.with_friction(task.mu, task.mu_torsion)
    return replace(believed, models=(task.contact_model,) * len(contacts))


def merge_per_finger(contacts: ContactSet) -> ContactSet:
    """One contact per finger (and one for the palm, finger ""), equal in wrench along its normal.

    The merged contact stands at the centre weighted by normal force, its normal is the mean so
    weighted, its force is the sum. Of the torque about the new point the part about the new normal
    is kept as torsion; the rest, which no soft finger transmits, is lost (it is small where the
    contacts of a pad lie close together). Friction is weighted likewise. Unloaded contacts count
    only where a finger has no others. Fingers keep the order of first appearance.
    """
    merged = []
    for finger in dict.fromkeys(contacts.fingers):
        index = [i for i, f in enumerate(contacts.fingers) if f == finger]
        merged.append(contacts[index[0]] if len(index) == 1 else _merged(contacts, index))
    return ContactSet.from_contacts(merged, center=contacts.center)


def other_touches(scene: Scene, data: Any) -> list[Touch]:
    """Loaded contacts that are not between hand and object."""
    touches = []
    for i in range(data.ncon):
        first, second = (int(g) for g in data.contact.geom[i])
        sides = {_side(scene, first): first, _side(scene, second): second}
        kind = _kind(set(sides))
        if kind is None:
            continue
        force = float(_force(scene.model, data, i)[0])
        if force > NO_FORCE:
            pair = [sides[side] for side in kind.split("-")] if len(sides) == 2 else [first, second]
            names = [_name(scene, g) for g in pair]
            touches.append(
                Touch(
                    kind=kind,
                    first=names[0].removeprefix(HAND_PREFIX),
                    second=names[1].removeprefix(HAND_PREFIX).removeprefix(OBSTACLE_PREFIX),
                    normal_force=force,
                )
            )
    return touches


def hand_collision(scene: Scene, data: Any) -> tuple[str, float]:
    """The pair with the largest normal force (N) of hand on table, obstacle or itself; "" and 0."""
    hits: dict[str, float] = defaultdict(float)
    for touch in other_touches(scene, data):
        if touch.kind.startswith("hand"):
            hits[f"{touch.first} - {touch.second}"] += touch.normal_force
    return max(hits.items(), key=lambda hit: hit[1], default=("", 0.0))


def _pairs(
    model: Any, data: Any, object_body: int, finger_of_geom: Mapping[int, str]
) -> list[tuple[int, int, bool]]:
    """Contact index, hand geom, and whether the object is geom 1, of every hand-object contact."""
    if data.ncon == 0:
        return []
    out = []
    body = model.geom_bodyid.tolist()
    for i, (first, second) in enumerate(data.contact.geom.tolist()):
        if second in finger_of_geom and body[first] == object_body:
            out.append((i, second, True))
        elif first in finger_of_geom and body[second] == object_body:
            out.append((i, first, False))
    return out


def _force(model: Any, data: Any, i: int) -> FloatArray:
    """f_n, f_t1, f_t2 (N) and tau_n (N m) of contact i on geom 2, in MuJoCo's frame, (4,)."""
    force = np.zeros(6)
    mujoco.mj_contactForce(model, data, i, force)
    return force[:4]


def _merged(contacts: ContactSet, index: list[int]) -> Contact:
    forces = np.nan_to_num(contacts.forces[index])
    weight = np.maximum(forces[:, 0], 0.0)
    total = float(weight.sum())
    weight = weight / total if total > 0 else np.full(len(index), 1.0 / len(index))
    normal = weight @ contacts.normals[index]
    if np.linalg.norm(normal) < MIN_MEAN_NORMAL:
        normal = contacts.normals[index[int(np.argmax(weight))]]
    positions = contacts.positions[index]
    center = weight @ positions
    single = ContactSet.from_arrays([center], [normal], center=center)
    frame = single.frames[0]
    in_axes = np.einsum("nij,nj->ni", contacts.frames[index], forces[:, :3])
    torque = np.cross(positions - center, in_axes).sum(axis=0)
    torque += forces[:, 3] @ contacts.normals[index]
    models = {contacts.models[i] for i in index}
    strongest: ContactModel = (
        "soft" if "soft" in models else "point" if "point" in models else "frictionless"
    )
    return Contact(
        position=center,
        frame=frame,
        model=strongest,
        mu=float(weight @ contacts.mu[index]),
        mu_torsion=float(weight @ contacts.mu_torsion[index]),
        force=np.append(frame.T @ in_axes.sum(axis=0), frame[:, 0] @ torque),
        finger=contacts.fingers[index[0]],
    )


MIN_MEAN_NORMAL = 0.1
"""Below this length (-) the mean of a finger's normals says nothing (it pinches the object by
itself); the normal of its strongest contact is taken."""


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
