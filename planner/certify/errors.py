"""Errors of contacts: at random within their sizes, and the worst against a given motion.

Both give ordinary contacts, whose closure anything can decide. They serve to test a promise of
``planner.certify.robust`` and to find where it really ends, not to make one.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from planner.contacts import ContactSet
from planner.spatial import FloatArray

__all__ = ["displaced", "random_directions", "random_errors", "worst_errors"]

_SMALL = 1e-12
"""Lengths below this share of the others have no direction (-)."""

_ARC = 65
"""Forces tried along the arc from the normal to the edge of the cone (-)."""


def displaced(contacts: ContactSet, shifts: FloatArray, axes: FloatArray) -> ContactSet:
    """Contacts with moved positions and turned frames.

    Args:
        contacts: n contacts.
        shifts: (n, 3), m, added to the positions.
        axes: (n, 3), rad: each frame is turned about this vector by its length.
    """
    return replace(
        contacts,
        positions=contacts.positions + shifts,
        frames=rotations(axes) @ contacts.frames,
    )


def random_errors(
    contacts: ContactSet, shifts: FloatArray, tilts: FloatArray, rng: np.random.Generator
) -> ContactSet:
    """Each contact moved by up to ``shifts`` (n,) m and tilted by up to ``tilts`` (n,) rad.

    Half of the draws are of the full size, where closure is lost first; the others of any.
    """
    n = len(contacts)
    size = np.where(rng.random((2, n)) < 0.5, 1.0, rng.random((2, n)))
    moved = (size[0] * shifts)[:, None] * random_directions(n, rng)
    across = np.cross(contacts.normals, random_directions(n, rng))
    axis = across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), _SMALL)
    return displaced(contacts, moved, (size[1] * tilts)[:, None] * axis)


def worst_errors(
    contacts: ContactSet, shifts: FloatArray, tilts: FloatArray, motion: FloatArray
) -> ContactSet:
    """Errors of the full size that take most support from a motion of the object.

    Each normal tilts away from the velocity of its contact, then each position goes where the
    force that still supports the motion does least: along -(f x w).

    Args:
        contacts: n contacts.
        shifts: (n,), m.
        tilts: (n,), rad.
        motion: (6,), [v; w] about ``contacts.center``, m and rad.
    """
    v, w = motion[:3], motion[3:]
    velocity = v + np.cross(w, contacts.positions - contacts.center)
    axis = _unit(np.cross(velocity, contacts.normals))
    tilted = displaced(contacts, np.zeros_like(velocity), tilts[:, None] * axis)
    along = np.einsum("ij,ij->i", velocity, tilted.normals)[:, None]
    sliding = _unit(velocity - along * tilted.normals)
    mu = np.where(np.array(contacts.dims) >= 3, contacts.mu, 0.0)
    # (arc, n, 3): forces from the normal to the edge of the cone towards the motion
    share = np.linspace(0.0, 1.0, _ARC)[:, None, None]
    forces = tilted.normals + share * mu[:, None] * sliding
    left = (forces * velocity).sum(axis=2) - shifts * np.linalg.norm(np.cross(forces, w), axis=2)
    best = forces[left.argmax(axis=0), np.arange(len(contacts))]
    return displaced(tilted, -shifts[:, None] * _unit(np.cross(best, w)), np.zeros_like(velocity))


def random_directions(n: int, rng: np.random.Generator) -> FloatArray:
    """Unit vectors (n, 3), uniform on the sphere."""
    return _unit(rng.normal(size=(n, 3)))


def rotations(axes: FloatArray) -> FloatArray:
    """Rotation matrices (n, 3, 3) about vectors (n, 3) by their lengths, rad."""
    return np.asarray(Rotation.from_rotvec(axes.reshape(-1, 3)).as_matrix())


def _unit(vectors: FloatArray) -> FloatArray:
    """Vectors (n, 3) at unit length; those without a length stay 0."""
    size = np.linalg.norm(vectors, axis=1, keepdims=True)
    least = _SMALL * max(float(size.max(initial=0.0)), _SMALL)
    return np.where(size > least, vectors / np.maximum(size, least), 0.0)
