"""Errors of contacts: at random within their sizes, and the worst against a given motion.

Both give ordinary contacts, whose closure anything can decide. They serve to test a promise of
``planner.certify.robust`` and to find where it really ends, not to make one.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from planner.contacts import ContactSet
from planner.spatial import FloatArray, contact_frames

_SMALL = 1e-12
"""Lengths below this share of the others have no direction (-)."""

_SIDE, _ZOOMS = 11, 6
"""Places along the side of a square that are tried, and times it shrinks to a quarter (-)."""


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
    """Errors that take most support from a motion of the object.

    Each normal tilts away from the velocity V of its contact; then each position goes by the d that
    makes least of the support n . V' + |(mu V'_t, mu_torsion n . w)|, V' = V + w x d. The product
    w x d is perpendicular to w: a disc is searched, on which
    the support is convex.

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
    size = float(np.linalg.norm(w))
    if size == 0.0:
        return tilted
    mu, mu_torsion = contacts.friction.T
    torsion = mu_torsion * (tilted.normals @ w)
    across = contact_frames(w)[0, :, 1:].T  # two unit vectors perpendicular to w
    axis_values = np.linspace(-1.0, 1.0, _SIDE)
    grid = np.stack(np.meshgrid(axis_values, axis_values), axis=2).reshape(-1, 1, 2)
    place = np.zeros((len(contacts), 2))  # of w x d, in units of |w| r
    for zoom in range(_ZOOMS):
        tried = place + 4.0**-zoom * grid  # (grid, n, 2)
        tried /= np.maximum(np.linalg.norm(tried, axis=2, keepdims=True), 1.0)
        moved = velocity + size * shifts[:, None] * (tried @ across)  # (grid, n, 3)
        along = (moved * tilted.normals).sum(axis=2)
        sliding = np.linalg.norm(moved - along[:, :, None] * tilted.normals, axis=2)
        best = (along + np.hypot(mu * sliding, torsion)).argmin(axis=0)
        place = tried[best, np.arange(len(contacts))]
    moved_by = -shifts[:, None] * np.cross(w / size, place @ across)
    return displaced(tilted, moved_by, np.zeros_like(velocity))


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
