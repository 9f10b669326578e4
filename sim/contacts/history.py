"""``ContactHistory``: MuJoCo's contacts of many moments, noted as they are and read later.

To note a moment takes some microseconds: copies of MuJoCo's arrays. Which of them are contacts of
hand and object, their frames and forces, comes out of one pass over all moments.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from planner.contacts import ContactSet
from planner.spatial import FloatArray, IntArray
from sim.contacts.reading import NO_FORCE, collisions, contact_forces
from sim.contacts.rows import ContactRows
from sim.scene.build import Scene


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

    def __init__(self, model: Any, object_body: int, finger_of_geom: Mapping[int, str]) -> None:
        """Start empty.

        Args:
            model: ``mujoco.MjModel``.
            object_body: Body id of the object, whose centre of mass torques are about.
            finger_of_geom: Geom ids of the hand, with the finger each belongs to ("" for none).
        """
        self._model, self._object = model, object_body
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
        return cls(scene.model, scene.object_body, scene.finger_of_geom)

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
        return self._model.geom_bodyid[geoms] == self._object

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
    history = ContactHistory(model, object_body, finger_of_geom)
    history.note(data)
    return history.read(with_unloaded=with_unloaded).at(0)


def hand_contacts(scene: Scene, data: Any) -> ContactSet:
    """Loaded contacts between a scene's hand and its object, in the world, not merged."""
    return contacts_from_mujoco(
        scene.model,
        data,
        object_body=scene.object_body,
        finger_of_geom=scene.finger_of_geom,
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
