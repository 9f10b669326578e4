"""Near-duplicates among grasps: found, and thinned to one each.

Two grasps of one object are near-duplicates if base position, base rotation, every contact and
every joint agree within tolerances. Grasps that a symmetry of the object turns into each other are
not: the hand stands elsewhere, which matters for learning and for choosing among grasps.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from planner.batch.features import GraspFeatures
from planner.errors import TaskError
from planner.spatial import FloatArray, IntArray

POSITION_TOL = 0.010
"""Distance (m) between two bases up to which they are alike: a tenth of a hand's length."""

ROTATION_TOL = float(np.deg2rad(10.0))
"""Turn (rad) between two bases up to which they are alike: about 10 mm at the fingertips, 6 cm
from the contacts' middle."""

CONTACT_TOL = 0.005
"""Distance (m) between two contacts of a finger up to which they are alike: less than half of a
pad's radius, and what a hand's placing error leaves."""

FLEXION_TOL = float(np.deg2rad(10.0))
"""Difference (rad; m for slides) of a joint up to which it is alike."""


def distances(grasps: GraspFeatures, i: int, others: IntArray) -> FloatArray:
    """How different grasp i is from others (m,), in tolerances: near-duplicates are at most 1.

    The largest of the four differences, each divided by its tolerance; a metric, since each is.
    """
    part = grasps[others]
    turn = np.einsum("nij,ij->n", part.rotations, grasps.rotations[i])  # trace of R_n R_i^T
    angles = np.arccos(np.clip((turn - 1.0) / 2.0, -1.0, 1.0))
    contacts = np.linalg.norm(_placed(part.contacts) - _placed(grasps.contacts[i]), axis=2)
    out: FloatArray = np.max(
        [
            np.linalg.norm(part.positions - grasps.positions[i], axis=1) / POSITION_TOL,
            angles / ROTATION_TOL,
            contacts.max(axis=1, initial=0.0) / CONTACT_TOL,
            np.abs(part.q - grasps.q[i]).max(axis=1, initial=0.0) / FLEXION_TOL,
        ],
        axis=0,
    )
    return out


AWAY = 1e3
"""Coordinate (m) where the contact of a finger that does not touch is put: grasps with different
fingers are never alike, and those without the same finger differ in nothing there."""


def _placed(contacts: FloatArray) -> FloatArray:
    """Contacts, with a place for missing ones."""
    return np.where(np.isnan(contacts), AWAY, contacts)


def thin(grasps: GraspFeatures, *, worth: FloatArray | None = None) -> IntArray:
    """Numbers of grasps, ascending, of which no two are near-duplicates, and that stand for all.

    The grasp of most worth is kept, its near-duplicates are dropped, and so on. Grasps of equal
    worth are ordered by their coordinates, so that the numbering makes no difference.

    Args:
        grasps: n grasps of one object.
        worth: (n,), larger is better, for example epsilon; all equal if None.

    Raises:
        TaskError: ``worth`` has another shape, or holds NaN.
    """
    n = len(grasps)
    value = np.zeros(n) if worth is None else np.asarray(worth, dtype=np.float64)
    if value.shape != (n,) or np.isnan(value).any():
        raise TaskError(f"worth has shape {value.shape}, or holds NaN; give {n} numbers")
    if n == 0:
        return np.zeros(0, dtype=np.int64)
    flat = np.hstack([grasps.positions, _placed(grasps.contacts).reshape(n, -1), grasps.q])
    # a ball of points is in a box of coordinates, which a tree finds quickly
    scale = np.concatenate(
        [
            np.full(3, POSITION_TOL),
            np.full(grasps.contacts[0].size, CONTACT_TOL),
            np.full(grasps.q.shape[1], FLEXION_TOL),
        ]
    )
    tree = cKDTree(flat / scale)
    dropped = np.zeros(n, dtype=bool)
    kept = []
    for i in np.lexsort((*flat.T[::-1], -value)):
        if dropped[i]:
            continue
        kept.append(int(i))
        near = np.array(tree.query_ball_point(flat[i] / scale, SLACK, p=np.inf), dtype=np.int64)
        near = near[~dropped[near]]
        dropped[near[distances(grasps, int(i), near) <= 1.0]] = True
    return np.array(sorted(kept), dtype=np.int64)


SLACK = 1.0 + 1e-9
"""Half-width (-) of the search box in tolerances, with room for rounding."""
