"""``ContactWorkspace``: grasp map and J^T of moving contacts in place; ``turned_frames``."""

from __future__ import annotations

import numpy as np

from planner.arrays import is_finite
from planner.contacts import ContactSet
from planner.errors import ContactError
from planner.spatial import FloatArray, contact_frames, skew

OPPOSED = 0.0
"""Cosine between an old and a new normal below which tangents are chosen anew (-): a turn by more
than 90 degrees multiplies rounding errors, and a pad that chatters has one at every step."""


class ContactWorkspace:
    """Where contacts are, and what they do to the object and to the joints.

    Attributes:
        positions, frames, center: As they are now; write them, then ``place``.
        table: (6, nx), the grasp map.
        lever: (nx, nv), joint torque per unknown, N m per N.
        plain: Whether all are point contacts and the forces all there is.
    """

    def __init__(
        self, contacts: ContactSet, length: float, unit: FloatArray, table: FloatArray, nv: int
    ) -> None:
        """Lay out.

        Args:
            contacts: As they are at first.
            length: Torques are divided by it, m.
            unit: Unit of each unknown per newton (nx,); force components come first.
            table: (6, nx), where the grasp map goes.
            nv: Number of joints.
        """
        dims = np.array(contacts.dims, dtype=np.int64)
        n, nx = len(dims), len(unit)
        wide = int(dims.max(initial=3))
        self.table, self._length, self._nv, self._unit = table, length, nv, unit
        self._soft = wide == 4
        self.positions, self.frames = np.array(contacts.positions), np.array(contacts.frames)
        self.center = np.array(contacts.center)
        # places of the unknowns among (n, wide) components, None where those are all
        present = np.flatnonzero((np.arange(wide) < dims[:, None]).ravel())
        direct = len(present) == wide * n == nx
        self._used = None if direct else present
        self.plain = direct and not self._soft
        # [1; skew(arm)] (n, 6, 3) is linear in (arm, 1); times the frames it is the grasp map
        self._arms, self._carry = np.ones((n, 4)), np.zeros((n, 18))
        self._from_arms = np.zeros((4, 18))
        self._from_arms[:3, 9:] = skew(np.eye(3)).reshape(3, 9) / length
        self._from_arms[3, :9] = np.eye(3).ravel()
        self._six = self._carry.reshape(-1, 6, 3)
        self._moved = self._arms[:, :3]
        self._turned = self.frames.transpose(0, 2, 1)
        self._map = np.zeros((n, 6, wide))
        self.lever = np.zeros((nx, nv))
        self._levers = np.zeros((n, wide, nv))
        if direct:
            self._map = table.reshape(6, n, wide).transpose(1, 0, 2)
            self._levers = self.lever.reshape(n, wide, nv)
        self._forces_map, self._force_levers = self._map[:, :, :3], self._levers[:, :3]

    def place(self) -> None:
        """Write the grasp map for the present places."""
        np.subtract(self.positions, self.center, out=self._moved)
        np.dot(self._arms, self._from_arms, out=self._carry)
        np.matmul(self._six, self.frames, out=self._forces_map)
        if self._soft:
            self._map[:, 3:, 3] = self.frames[:, :, 0] / self._length
        if self._used is not None:
            columns = self._map.transpose(1, 0, 2).reshape(6, -1)[:, self._used]
            self.table[:, : len(self._used)] = columns
        if self._soft:
            self.table *= self._unit

    def load(self, jacobians: FloatArray) -> None:
        """Write the levers from Jacobians (n, 3 or 6, nv).

        Raises:
            ContactError: Another shape.
        """
        n, rows = len(self.frames), 6 if self._soft else 3
        given = jacobians.shape
        if len(given) != 3 or given[0] != n or given[1] < rows or given[2] != self._nv:
            raise ContactError(f"jacobians have shape {given}; give ({n}, {rows}, {self._nv})")
        if not is_finite(jacobians):
            raise ContactError("jacobians hold NaN or infinity; give finite numbers")
        np.matmul(self._turned, jacobians[:, :3], out=self._force_levers)
        if self._soft:
            np.matmul(self._turned[:, :1], jacobians[:, 3:], out=self._levers[:, 3:])
        if self._used is not None:
            self.lever[: len(self._used)] = self._levers.reshape(-1, self._nv)[self._used]
        if self._soft:
            self.lever *= self._unit[:, None]


def turned_frames(frames: FloatArray, normals: FloatArray) -> FloatArray:
    """Contact frames (n, 3, 3) turned by the least rotation onto unit normals (n, 3).

    Tangents then move as little as the normals do, where ``contact_frames`` may jump.
    """
    old = frames[:, :, 0]
    cosine = (old * normals).sum(axis=1)
    if (cosine < OPPOSED).any():
        return contact_frames(normals)
    dyad = normals[:, :, None] * old[:, None]
    turn = dyad - dyad.transpose(0, 2, 1)  # the cross-product matrix of old x normals
    rotation = IDENTITY + turn + turn @ turn / (1.0 + cosine)[:, None, None]
    return np.asarray(rotation @ frames)


IDENTITY = np.eye(3)
