"""Contacts of many moments: noted as MuJoCo had them, kept as arrays, merged for all at once.

To note a moment takes some microseconds: copies of MuJoCo's arrays. Which of them are contacts of
hand and object, their frames and forces, comes out of one pass over all moments.

``ContactRows``: contacts of many moments as arrays, and ``merge_per_finger`` for all at once.

A trial has hundreds of samples with a few contacts each. Kept as rows, they are merged, and their
forces turned, by a few calls for all; a ``ContactSet`` is made of the moments that are asked for.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import mujoco
import numpy as np

from planner.contacts import CONTACT_DIM, ContactModel, ContactSet
from planner.contacts.friction import cone_utilisation
from planner.spatial import FloatArray, IntArray, contact_frames
from planner.task import GraspTask
from sim.contacts.reading import NO_FORCE, collisions, contact_forces
from sim.scene.build import Scene

MIN_MEAN_NORMAL = 0.1
"""Below this length (-) the mean of a finger's normals says nothing (it pinches the object by
itself); the normal of its strongest contact is taken."""

_MODEL: dict[int, ContactModel] = {1: "frictionless", 3: "point", 4: "soft", 6: "soft"}
"""Contact model by MuJoCo's condim."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ContactRows:
    """K contacts of m moments, moment by moment; world axes, forces on the object.

    Attributes:
        names: Names of the fingers, "" for the rest of the hand.
        centers: (m, 3), the object's centre of mass, m.
        moment: (K,), which moment a contact belongs to, ascending.
        finger: (K,), its place in ``names``.
        positions: (K, 3), m.
        frames: (K, 3, 3), columns [normal into the object, tangent1, tangent2].
        dims: (K,), force components: 1, 3, 4, or MuJoCo's 6, which is read as 4.
        friction: (K, 2), sliding (-) and torsional (m).
        forces: (K, 4), in the frames, N and N m.
    """

    names: tuple[str, ...]
    centers: FloatArray
    moment: IntArray
    finger: IntArray
    positions: FloatArray
    frames: FloatArray
    dims: IntArray
    friction: FloatArray
    forces: FloatArray

    def of(self, moment: int) -> slice:
        """Where the contacts of one moment stand."""
        first, last = self._bounds[moment : moment + 2].tolist()
        return slice(first, last)

    def at(self, moment: int) -> ContactSet:
        """The contacts of one moment, about the object's centre of mass then."""
        rows = self.of(moment)
        mu, torsion = self.friction[rows].T
        return ContactSet(
            positions=self.positions[rows],
            frames=self.frames[rows],
            models=tuple(_MODEL[dim] for dim in self.dims[rows].tolist()),
            mu=mu,
            mu_torsion=torsion,
            forces=self.forces[rows],
            fingers=tuple(self.names[k] for k in self.finger[rows].tolist()),
            center=self.centers[moment],
        )

    def counts(self) -> IntArray:
        """Number of contacts per moment and finger, (m, len(names))."""
        out = np.zeros((len(self.centers), len(self.names)), dtype=np.int64)
        np.add.at(out, (self.moment, self.finger), 1)
        return out

    def used_friction(self) -> FloatArray:
        """Friction (K, 2) as far as the contacts' models have it: see ``ContactSet.friction``."""
        return self.friction * (self.dims[:, None] >= [3, 4])

    def friction_utilisation(self) -> FloatArray:
        """Share of the friction cone that each force uses (K,), -."""
        torsion = np.where(self.dims >= CONTACT_DIM["soft"], self.friction[:, 1], np.nan)
        return cone_utilisation(self.forces, self.friction[:, 0], torsion)

    def forces_in_axes(self) -> FloatArray:
        """Forces on the object (K, 3), world axes, N."""
        return np.asarray(np.einsum("nij,nj->ni", self.frames, self.forces[:, :3]))

    def columns(self, fingers: tuple[str, ...], rest: str) -> dict[str, Any]:
        """Merged contacts as fields of a ``Recording``: a column per finger and other part.

        Args:
            fingers: Names of the first columns.
            rest: Name of the column of what belongs to no finger.
        """
        rest = f"{rest} (rest)" if rest in fingers else rest  # a palm that takes part has that name
        own = [name or rest for name in self.names]
        touching = [own[k] for k in dict.fromkeys(self.finger.tolist())]
        names = tuple(dict.fromkeys((*fingers, *touching)))
        place = np.array([names.index(name) if name in names else -1 for name in own])
        where = self.moment, place[self.finger]
        m, k = len(self.centers), len(names)
        points, normals, forces = np.full((3, m, k, 3), np.nan)
        friction = np.full((m, k, 2), np.nan)
        points[where], normals[where] = self.positions, self.frames[:, :, 0]
        forces[where], friction[where] = self.forces_in_axes(), self.used_friction()
        return {
            "contact_names": names,
            "points": points,
            "normals": normals,
            "forces": forces,
            "friction": friction,
        }

    @cached_property
    def merged(self) -> ContactRows:
        """One contact per moment and finger; see ``merge_per_finger``."""
        group, first = self._groups
        if len(first) == len(group):
            return self
        out = self._taken(first)
        size = np.bincount(group, minlength=len(first))
        several = size > 1
        many = several[group]
        number = np.cumsum(several) - 1  # of a group among those of several contacts
        merged = self._taken(np.flatnonzero(many))._sums(number[group[many]], int(several.sum()))
        for name in ("positions", "frames", "dims", "friction", "forces"):
            getattr(out, name)[several] = getattr(merged, name)
        return out

    @cached_property
    def _bounds(self) -> IntArray:
        """Where the contacts of each moment begin, (m + 1,)."""
        return np.searchsorted(self.moment, np.arange(len(self.centers) + 1))

    @cached_property
    def _groups(self) -> tuple[IntArray, IntArray]:
        """Number of the group of each contact (K,), and the first contact of each, ascending."""
        key = self.moment * len(self.names) + self.finger
        _, first, group = np.unique(key, return_index=True, return_inverse=True)
        order = np.argsort(first)
        place = np.empty(len(order), dtype=np.int64)
        place[order] = np.arange(len(order))
        return place[group.reshape(-1)], first[order]

    def _taken(self, rows: IntArray) -> ContactRows:
        """Copies of some contacts."""
        columns = ("moment", "finger", "positions", "frames", "dims", "friction", "forces")
        taken = {name: getattr(self, name)[rows] for name in columns}
        return ContactRows(names=self.names, centers=self.centers, **taken)

    def _sums(self, group: IntArray, n: int) -> ContactRows:
        """Merge contacts (K,) by their groups, 0 to n - 1."""
        forces, normals = np.nan_to_num(self.forces), self.frames[:, :, 0]
        weight = np.maximum(forces[:, 0], 0.0)
        total, size = _summed(group, weight, n)[group], _summed(group, np.ones(len(group)), n)
        weight = np.where(total > 0, weight / np.where(total > 0, total, 1.0), 1.0 / size[group])
        normal = _summed(group, weight[:, None] * normals, n)
        for k in np.flatnonzero(np.linalg.norm(normal, axis=1) < MIN_MEAN_NORMAL):
            members = np.flatnonzero(group == k)
            normal[k] = normals[members[np.argmax(weight[members])]]
        center = _summed(group, weight[:, None] * self.positions, n)
        frames = contact_frames(normal)
        in_axes = np.einsum("nij,nj->ni", self.frames, forces[:, :3])
        about = np.cross(self.positions - center[group], in_axes) + forces[:, 3:] * normals
        force, torque = _summed(group, in_axes, n), _summed(group, about, n)
        dims = np.zeros(n, dtype=np.int64)
        np.maximum.at(dims, group, self.dims)
        spin = (frames[:, :, 0] * torque).sum(axis=1)
        first = np.unique(group, return_index=True)[1]
        return ContactRows(
            names=self.names,
            centers=self.centers,
            moment=self.moment[first],
            finger=self.finger[first],
            positions=center,
            frames=frames,
            dims=dims,
            friction=_summed(group, weight[:, None] * self.friction, n),
            forces=np.column_stack([np.einsum("nij,ni->nj", frames, force), spin]),
        )


def merge_per_finger(contacts: ContactSet) -> ContactSet:
    """One contact per finger (and one for the palm, finger ""), equal in wrench along its normal.

    The merged contact stands at the centre weighted by normal force, its normal is the mean so
    weighted, its force is the sum. Of the torque about the new point the part about the new normal
    is kept as torsion; the rest, which no soft finger transmits, is lost (it is small where the
    contacts of a pad lie close together). Friction is weighted likewise. Unloaded contacts count
    only where a finger has no others. Fingers keep the order of first appearance.
    """
    names = tuple(dict.fromkeys(contacts.fingers))
    if len(names) == len(contacts):
        return contacts
    rows = ContactRows(
        names=names,
        centers=contacts.center[None],
        moment=np.zeros(len(contacts), dtype=np.int64),
        finger=np.array([names.index(f) for f in contacts.fingers], dtype=np.int64),
        positions=contacts.positions,
        frames=contacts.frames,
        dims=np.array([CONTACT_DIM[model] for model in contacts.models], dtype=np.int64),
        friction=np.stack([contacts.mu, contacts.mu_torsion], axis=1),
        forces=contacts.forces,
    )
    return rows.merged.at(0)


def with_planned_friction(contacts: ContactSet, task: GraspTask) -> ContactSet:
    """Measured contacts under the friction and the contact model that planning relies on.

    What simulation has beside that, more friction and torsion, is no part of it.
    """
    believed = contacts.with_friction(task.mu, task.mu_torsion)
    return replace(believed, models=(task.contact_model,) * len(contacts))


def _summed(group: IntArray, values: FloatArray, n: int) -> FloatArray:
    """Sums (n, ...) of values (K, ...) by group."""
    out = np.zeros((n, *values.shape[1:]))
    np.add.at(out, group, values)
    return out


@dataclass(frozen=True, kw_only=True, eq=False)
class _Noted:
    """All contacts of all moments, whatever touches.

    Attributes:
        moment: (K,), which moment each belongs to.
        geoms: (K, 2).
        positions: (K, 3), m, world.
        frames: (K, 3, 3), MuJoCo's: axes in rows.
        dims: (K,).
        friction: (K, 2), sliding (-) and torsional (m).
        forces: (K, 4), on geom 2 in MuJoCo's frame, N and N m.
    """

    moment: IntArray
    geoms: IntArray
    positions: FloatArray
    frames: FloatArray
    dims: IntArray
    friction: FloatArray
    forces: FloatArray


class ContactHistory:
    """Contacts of a model over time."""

    def __init__(
        self,
        model: Any,
        object_body: int,
        finger_of_geom: Mapping[int, str],
        object_geoms: Collection[int] | None = None,
    ) -> None:
        """Start empty.

        Args:
            model: ``mujoco.MjModel``.
            object_body: Body id of the object, whose centre of mass torques are about.
            finger_of_geom: Geom ids of the hand, with the finger each belongs to ("" for none).
            object_geoms: Ids of the object's geoms, if it has more bodies; of that body if None.
        """
        self._model, self._object = model, object_body
        self._own = model.geom_bodyid == object_body
        if object_geoms is not None:
            self._own = np.isin(np.arange(model.ngeom), list(object_geoms))
        self._names = tuple(dict.fromkeys((*finger_of_geom.values(), "")))
        self._finger = np.full(model.ngeom, -1, dtype=np.int64)
        for geom, name in finger_of_geom.items():
            self._finger[geom] = self._names.index(name)
        self._pyramids = model.opt.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL
        self._moments: list[tuple[Any, ...]] = []
        self._centers: list[FloatArray] = []
        self._read: ContactRows | None = None

    @classmethod
    def of(cls, scene: Scene) -> ContactHistory:
        """An empty one of a scene."""
        return cls(scene.model, scene.object_body, scene.finger_of_geom, scene.object_geoms)

    def note(self, data: Any) -> None:
        """Note the contacts of ``mujoco.MjData`` after a step."""
        contact = data.contact
        self._moments.append(
            (
                contact.geom.copy(),
                contact.pos.copy(),
                contact.frame.copy(),
                contact.dim.copy(),
                contact.friction.copy(),
                contact_forces(self._model, data) if self._pyramids else data.efc_force.copy(),
                contact.efc_address.copy(),
            )
        )
        self._centers.append(data.xipos[self._object].copy())
        self._read = None

    def rows(self) -> ContactRows:
        """The loaded contacts of hand and object, not merged; read once."""
        if self._read is None:
            self._read = self.read()
        return self._read

    def read(self, *, with_unloaded: bool = False) -> ContactRows:
        """The contacts of hand and object, not merged.

        Args:
            with_unloaded: Also those without force, which lie inside the margin.
        """
        noted = self._noted()
        finger, of_object = self._finger[noted.geoms], self._of_object(noted.geoms)
        object_first = of_object[:, 0] & (finger[:, 1] >= 0)
        object_second = of_object[:, 1] & (finger[:, 0] >= 0) & ~object_first
        loaded = noted.forces[:, 0] > NO_FORCE
        kept = np.flatnonzero((object_first | object_second) & (loaded | with_unloaded))
        turned = object_first[kept]
        frames = noted.frames[kept].transpose(0, 2, 1).copy()
        frames[turned, :, :2] *= -1.0
        forces, dims = noted.forces[kept], noted.dims[kept]
        forces[turned, 2] *= -1.0
        friction = noted.friction[kept]
        friction[dims < 4, 1] = 0.0
        return ContactRows(
            names=self._names,
            centers=np.array(self._centers).reshape(-1, 3),
            moment=noted.moment[kept],
            finger=np.where(turned, finger[kept, 1], finger[kept, 0]),
            positions=noted.positions[kept],
            frames=frames,
            dims=dims,
            friction=friction,
            forces=forces,
        )

    def collisions(self, scene: Scene) -> tuple[tuple[str, ...], FloatArray]:
        """The pair with the largest normal force of hand on table, obstacle or itself, per moment.

        Returns:
            m names of the pair, "" without, and the forces (m,), N.
        """
        noted = self._noted()
        hand, of_object = self._finger[noted.geoms] >= 0, self._of_object(noted.geoms)
        aside = hand.any(axis=1) & ~of_object.any(axis=1) & (noted.forces[:, 0] > NO_FORCE)
        pairs, forces = [""] * len(self._moments), np.zeros(len(self._moments))
        rows = np.flatnonzero(aside)
        for moment in np.unique(noted.moment[rows]).tolist():
            mine = rows[noted.moment[rows] == moment]
            pairs[moment], forces[moment] = collisions(
                scene, noted.geoms[mine].tolist(), noted.forces[mine, 0].tolist()
            )
        return tuple(pairs), forces

    def _of_object(self, geoms: IntArray) -> Any:
        """Which geoms (K, 2) belong to the object."""
        return self._own[geoms]

    def _noted(self) -> _Noted:
        """All moments one after the other."""
        none: tuple[Any, ...] = (np.zeros((0, 2), dtype=np.int64),)
        none += (np.zeros((0, 3)), np.zeros((0, 9)), np.zeros(0, dtype=np.int64))
        none += (np.zeros((0, 5)), np.zeros((0, 4)) if self._pyramids else np.zeros(0))
        none += (np.zeros(0, dtype=np.int64),)
        columns = list(zip(none, *self._moments, strict=True))
        geoms, positions, frames, dims, friction, forces, address = map(np.concatenate, columns)
        counts = [len(moment[0]) for moment in self._moments]
        dims = dims.astype(np.int64)
        if not self._pyramids:
            starts = np.cumsum([0, *(len(moment[5]) for moment in self._moments)])[:-1]
            forces = _elliptic_forces(forces, np.repeat(starts, counts), address, dims)
        return _Noted(
            moment=np.repeat(np.arange(len(counts)), counts),
            geoms=geoms.astype(np.int64),
            positions=positions,
            frames=frames.reshape(-1, 3, 3),
            dims=dims,
            friction=friction[:, [0, 2]],
            forces=forces,
        )


def contacts_from_mujoco(
    model: Any,
    data: Any,
    *,
    object_body: int,
    finger_of_geom: Mapping[int, str],
    object_geoms: Collection[int] | None = None,
    with_unloaded: bool = False,
) -> ContactSet:
    """Contacts between a hand and an object, in the world, with the forces on the object.

    Args:
        model: ``mujoco.MjModel``.
        data: ``mujoco.MjData`` after a step.
        object_body: Body id of the object; its centre of mass becomes the set's centre.
        finger_of_geom: Geom ids of the hand, with the finger each belongs to ("" for none).
        object_geoms: Ids of the object's geoms, if it has more bodies; of that body if None.
        with_unloaded: Also contacts without force, which lie inside the margin.

    Returns:
        The contacts in MuJoCo's order, not merged.
    """
    history = ContactHistory(model, object_body, finger_of_geom, object_geoms)
    history.note(data)
    return history.read(with_unloaded=with_unloaded).at(0)


def hand_contacts(scene: Scene, data: Any) -> ContactSet:
    """Loaded contacts between a scene's hand and its object, in the world, not merged."""
    return contacts_from_mujoco(
        scene.model,
        data,
        object_body=scene.object_body,
        finger_of_geom=scene.finger_of_geom,
        object_geoms=scene.object_geoms,
    )


def _elliptic_forces(
    efc_force: FloatArray, starts: IntArray, address: IntArray, dims: IntArray
) -> FloatArray:
    """The same from constraint forces, which they are with elliptic cones, all at once.

    Args:
        efc_force: Constraint forces of all moments.
        starts: (K,), where those of a contact's moment begin.
        address: (K,), where its own begin after that; negative for one without any.
        dims: (K,), how many it has.
    """
    part = np.arange(4)
    has = (part < dims[:, None]) & (address >= 0)[:, None]
    out = np.zeros((len(dims), 4))
    out[has] = efc_force[((starts + address)[:, None] + part)[has]]
    return out
