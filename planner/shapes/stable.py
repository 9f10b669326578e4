"""Stable poses of a solid on a table: the faces of its convex hull under its centre of mass.

On an unstable face it topples over the edge that its centre of mass is farthest beyond, to the next
face, until it stands. The probability of a pose is the solid angle, seen from the centre
of mass, of all faces that end there: a quasi-static drop in a random orientation (after Boothroyd,
Poli and Murch, "Automatic assembly", 1982: the centroid solid angle).

By hand: ``trimesh.poses`` needs networkx and gives neither the tilt at which a pose falls nor one
pose for the facets of a round bottom.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from planner.shapes.meshes.triangles import solid_angles
from planner.spatial import FloatArray, IntArray

if TYPE_CHECKING:
    from scipy.spatial import ConvexHull

FLAT_DEG = 0.5
"""Neighbouring faces of the hull that differ by less than this angle (degrees) are one face: the
facets of a scanned or finely divided bottom."""

LEAST_TILT_DEG = 2.0
"""A pose that falls when tilted by less than this (degrees) is listed only if there is no other."""


ROUNDING = 1e-12
"""More than two ways of computing the cosine of an angle differ by."""


@dataclass(frozen=True, kw_only=True, eq=False)
class StablePose:
    """One way of standing on a horizontal table.

    Attributes:
        rotation: (3, 3), world from object.
        height: Of the centre of mass above the table, m.
        margin_deg: Tilt, degrees, in the worst direction, at which it falls; None if not known.
        probability: That it comes to stand so when dropped; None if not known.
    """

    rotation: FloatArray
    height: float
    margin_deg: float | None = None
    probability: float | None = None


def stable_poses(points: FloatArray, hull: ConvexHull | None = None) -> tuple[StablePose, ...]:
    """Stable poses, the one that can be tilted farthest first.

    The preferred pose of a mug is upright (falls at 40 degrees), although a dropped mug more often
    ends against its handle (5 degrees). Of equal poses, the one that turns the object least is
    first.

    Args:
        points: Points (n, 3) whose hull is that of the solid, m; its centre of mass is the origin.
        hull: The hull of exactly these points, where it is known.
    """
    if hull is None:
        from planner.system.scipy_parts import ConvexHull  # here: SciPy loads slowly

        hull = ConvexHull(points)
    normals, offsets = hull.equations[:, :3], -hull.equations[:, 3]
    corners = points[hull.simplices]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    group = _coplanar(normals, np.linalg.norm(cross, axis=1), hull.neighbors)
    inward = np.einsum("nd,nd->n", cross, normals) < 0
    corners[inward] = corners[inward][:, ::-1]
    faces = _Faces(group, normals, offsets, corners)
    # edges between groups: each simplex has one opposite to each of its corners
    face, other = np.repeat(np.arange(len(normals)), 3), hull.neighbors.ravel()
    rim = group[face] != group[other]
    ends = hull.simplices[face[rim]][
        np.arange(rim.sum())[:, None], _others(np.tile(np.arange(3), len(normals))[rim])
    ]
    inside = faces.inside(group[face[rim]], points[ends])
    worst = np.full(len(faces.normals), np.inf)
    np.minimum.at(worst, group[face[rim]], inside)
    ends_at = _topple(worst, group[face[rim]], group[other[rim]], inside)
    share = np.bincount(ends_at, weights=faces.solid_angles, minlength=len(worst))
    tilt = np.degrees(np.arctan2(worst, faces.heights))
    kept = np.flatnonzero(tilt >= LEAST_TILT_DEG)
    if len(kept) == 0:
        kept = np.array([int(np.argmax(tilt))])
    # of two normals, the one that points more downwards needs the lesser turn
    order = kept[np.lexsort((faces.normals[kept, 2], -np.round(tilt[kept], 1)))]
    return tuple(
        StablePose(
            rotation=_upright(faces.normals[g]),
            height=float(faces.heights[g]),
            margin_deg=float(tilt[g]),
            probability=float(share[g]),
        )
        for g in order
    )


def _coplanar(normals: FloatArray, areas: FloatArray, neighbours: IntArray) -> IntArray:
    """Number (n,) of the face that each simplex is of, the largest simplex of a face deciding.

    Simplices are compared with that one, not with their neighbour: a round flank is not one face.
    """
    group = [-1] * len(normals)
    least, count = np.cos(np.radians(FLAT_DEG)), 0
    towards = np.einsum("nkd,nd->nk", normals[neighbours], normals)
    alone = (towards < least - ROUNDING).all(axis=1).tolist()
    for seed in np.argsort(-areas, kind="stable").tolist():
        if group[seed] >= 0:
            continue
        group[seed], queue = count, [] if alone[seed] else [seed]
        while queue:
            for other in neighbours[queue.pop()].tolist():
                if group[other] < 0 and normals[other] @ normals[seed] > least:
                    group[other] = count
                    queue.append(other)
        count += 1
    return np.array(group)


class _Faces:
    """Faces of the hull: groups of coplanar simplices."""

    def __init__(
        self, group: IntArray, normals: FloatArray, offsets: FloatArray, corners: FloatArray
    ) -> None:
        count = int(group.max()) + 1
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        area = np.linalg.norm(cross, axis=1)
        total = np.zeros((count, 3))
        np.add.at(total, group, area[:, None] * normals)
        length = np.linalg.norm(total, axis=1, keepdims=True)
        self.normals = total / length
        self.heights = np.zeros(count)
        np.maximum.at(self.heights, group, offsets)
        angles = np.bincount(group, weights=solid_angles(corners), minlength=count)
        self.solid_angles = angles / angles.sum()
        self.middles = (
            np.stack(
                [
                    np.bincount(group, weights=area * corners.mean(axis=1)[:, k], minlength=count)
                    for k in range(3)
                ],
                axis=1,
            )
            / np.bincount(group, weights=area, minlength=count)[:, None]
        )

    def inside(self, group: IntArray, ends: FloatArray) -> FloatArray:
        """How far (m) below the centre of mass is inside of each edge (n, 2 ends, 3) of a face."""
        normal = self.normals[group]
        along = ends[:, 1] - ends[:, 0]
        inward = np.cross(normal, along)
        inward /= np.linalg.norm(inward, axis=1, keepdims=True)
        to_middle = np.einsum("nd,nd->n", self.middles[group] - ends[:, 0], inward)
        inward *= np.where(to_middle < 0, -1.0, 1.0)[:, None]
        distance: FloatArray = -np.einsum("nd,nd->n", ends[:, 0], inward)
        return distance


def _others(k: IntArray) -> IntArray:
    """The two corners (n, 2) of a triangle that are not corner k."""
    return np.stack([(k + 1) % 3, (k + 2) % 3], axis=1)


def _topple(worst: FloatArray, of: IntArray, to: IntArray, inside: FloatArray) -> IntArray:
    """The stable face at which each face ends."""
    following = np.arange(len(worst))
    unstable = np.flatnonzero(worst < 0)
    order = np.lexsort((inside, of))
    first = order[np.searchsorted(of[order], unstable)]
    following[unstable] = to[first]
    # the centre of mass falls at each step, so no chain is longer than there are faces
    for _ in range(len(worst)):
        further = following[following]
        if (further == following).all():
            break
        following = further
    return following


def _upright(normal: FloatArray) -> FloatArray:
    """The smallest rotation (3, 3) that turns a face's outward normal downwards."""
    down = np.array([0.0, 0.0, -1.0])
    cosine = float(normal @ down)
    if cosine < -1 + 1e-12:
        return np.diag([1.0, -1.0, -1.0])
    v = np.cross(normal, down)
    skew = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    rotation: FloatArray = np.eye(3) + skew + skew @ skew / (1 + cosine)
    return rotation
