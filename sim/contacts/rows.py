"""``ContactRows``: contacts of many moments as arrays, and ``merge_per_finger`` for all at once.

A trial has hundreds of samples with a few contacts each. Kept as rows, they are merged, and their
forces turned, by a few calls for all; a ``ContactSet`` is made of the moments that are asked for.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from planner.contacts import CONTACT_DIM, ContactModel, ContactSet
from planner.contacts.friction import cone_utilisation
from planner.spatial import FloatArray, IntArray, contact_frames
from planner.task import GraspTask

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
