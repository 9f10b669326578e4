"""Convex hulls: as arrays, as coal geometries, and the stable poses of a solid on its own.

coal refuses a hull with a corner of 255 or more neighbours ("Too many neighbors"). Such corners
have two causes. A flat face of many corners is triangulated as a fan from one of them: joggled
input (Qhull's QJ, by 1e-13 m) leaves no face flat and gives another triangulation. The apex of a
cone has as many neighbours as its rim has corners: it is cut off by a micrometre, and the new
corners share the neighbours.

A solid stands on the faces of its hull that are under its centre of mass. On an unstable face it
topples over the edge that its centre of mass is farthest beyond, to the next face, until it stands.
The probability of a pose is the solid angle, seen from the centre of mass, of all faces that end
there: a quasi-static drop in a random orientation (after Boothroyd, Poli and Murch, "Automatic
assembly", 1982: the centroid solid angle). By hand: ``trimesh.poses`` needs networkx and gives
neither the tilt at which a pose falls nor one pose for the facets of a round bottom.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import coal
import numpy as np

from planner.errors import ModelError
from planner.shapes.meshes.triangles import solid_angles
from planner.spatial import FloatArray, IntArray

if TYPE_CHECKING:
    from scipy.spatial import ConvexHull


BLUNT = 1e-6
"""How far (m) from an apex its edges are cut: nothing of the hull that is lost is farther than that
from what remains. It is coal's accuracy."""

MOST_NEIGHBOURS = 200
"""Neighbours up to which a corner stays as it is; coal refuses 255."""

SHARE = 64
"""Neighbours, about, of each corner that takes the place of an apex."""


def convex_geometry(corners: FloatArray) -> Any:
    """The convex hull with these corners as a ``coal.Convex``.

    Args:
        corners: (n, 3), m, of a solid: not in one plane, or coal crashes.
    """
    hull = _coal_hull(corners, "Qt")  # triangulated, as coal asks for
    if hull is None:
        hull = _coal_hull(corners, "QJ")
    if hull is None:
        hull = _coal_hull(_blunted(corners), "QJ")
    if hull is None:  # never: no corner has more than some SHARE neighbours by now
        raise ModelError(f"coal refuses a convex hull of {len(corners)} corners; simplify the mesh")
    return hull


TOO_MANY = "Too many neighbors"
"""coal's message about a corner with too many neighbours."""


def _coal_hull(corners: FloatArray, options: str) -> Any | None:
    """The hull by coal; None where a corner has too many neighbours."""
    points = coal.StdVec_Vec3s()
    points.extend(list(np.asarray(corners, dtype=np.float64)))
    try:
        return coal.Convex.convexHull(points, True, options)
    except RuntimeError as fault:
        if TOO_MANY not in str(fault):
            raise
    return None


def _blunted(corners: FloatArray) -> FloatArray:
    """Corners (m, 3) of a hull (n, 3), m, with the apices cut off that have too many neighbours."""
    edges = _edges(corners)
    crowded = np.flatnonzero(np.bincount(edges[:, 0], minlength=len(corners)) > MOST_NEIGHBOURS)
    parts = [np.delete(corners, crowded, axis=0)]
    for apex in crowded:
        along = corners[edges[edges[:, 0] == apex, 1]] - corners[apex]
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        around = along[_turns(along)]
        parts.append(corners[apex] + BLUNT * around[::SHARE])
    return np.concatenate(parts)


def _edges(corners: FloatArray) -> IntArray:
    """Both ways of every edge of a hull with these corners, (k, 2) numbers of corners."""
    from planner.system.scipy_parts import ConvexHull  # here: SciPy loads slowly

    simplices = ConvexHull(corners, qhull_options="QJ").simplices
    ways = [simplices[:, [a, b]] for a in range(3) for b in range(3) if a != b]
    return np.unique(np.concatenate(ways), axis=0).astype(np.int64)


def _turns(along: FloatArray) -> IntArray:
    """The order of directions (n, 3) around their mean."""
    axis = along.mean(axis=0)
    first = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    second = np.cross(axis, first) / max(float(np.linalg.norm(axis)), TINY)
    order: IntArray = np.argsort(np.arctan2(along @ second, along @ first))
    return order


TINY = 1e-300
"""Against division by 0."""


FLAT = 1e-12
"""Volume (m3) below which points span no solid: a cube of 0.1 mm. MuJoCo refuses such meshes."""

SURE = 1e-7
"""How deep (m) inside of all planes a point is counted as inside: rounding."""

STEP = 48
"""Planes per test; points outside one of them are not tested further."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Hull:
    """A convex polyhedron.

    Attributes:
        points: Its corners (n, 3), m.
        faces: (m, 3), counter-clockwise seen from outside.
        planes: (k, 4), outward unit normal and offset: n x + d <= 0 inside.
        volume: m3.
    """

    points: FloatArray
    faces: IntArray
    planes: FloatArray
    volume: float

    @property
    def triangles(self) -> FloatArray:
        """Corners (m, 3 corners, 3) of the faces, m."""
        triangles: FloatArray = self.points[self.faces]
        return triangles

    def inside(self, points: FloatArray) -> IntArray:
        """Indices of the points (n, 3) that are inside."""
        low, high = self.points.min(axis=0), self.points.max(axis=0)
        index = np.flatnonzero(((points > low) & (points < high)).all(axis=1))
        left = points[index]
        for start in range(0, len(self.planes), STEP):
            if len(left) == 0:
                break
            planes = self.planes[start : start + STEP]
            keep = (left @ planes[:, :3].T + planes[:, 3]).max(axis=1) < -SURE
            index, left = index[keep], left[keep]
        return index

    def depths(self, points: FloatArray) -> FloatArray:
        """How deep (n,), m, inside of the nearest plane points (n, 3) are."""
        depths: FloatArray = -(points @ self.planes[:, :3].T + self.planes[:, 3]).max(axis=1)
        return depths


def hull_of(points: FloatArray) -> Hull | None:
    """The convex hull of points (n, 3), m; None if they span no solid."""
    from planner.system.scipy_parts import ConvexHull, QhullError  # here: SciPy loads slowly

    if len(points) < 4:
        return None
    try:
        hull = ConvexHull(points)
    except QhullError:
        return None
    if hull.volume < FLAT:
        return None
    number = np.zeros(len(points), dtype=np.int64)
    number[hull.vertices] = np.arange(len(hull.vertices))
    faces, normals = hull.simplices, hull.equations[:, :3]
    a, b, c = (points[faces[:, k]] for k in range(3))
    inward = np.einsum("nd,nd->n", np.cross(b - a, c - a), normals) < 0
    faces = np.where(inward[:, None], faces[:, ::-1], faces)
    return Hull(
        points=points[hull.vertices],
        faces=number[faces],
        planes=hull.equations,
        volume=float(hull.volume),
    )


def clip(triangles: FloatArray, normal: FloatArray, offset: float) -> FloatArray:
    """The part of triangles with normal x <= offset.

    A triangle that only touches the plane from beyond, or lies in it, is left out: of a solid, what
    is next to it on this side has the same corners.

    Args:
        triangles: (n, 3 corners, 3), m.
        normal: (3,).
        offset: m.

    Returns:
        Triangles (m, 3 corners, 3), m, of the same orientation.
    """
    height = _heights(triangles, normal, offset)
    some = height.min(axis=1) < 0
    triangles, height = triangles[some], height[some]
    kept = height <= 0
    count = kept.sum(axis=1)
    out = [triangles[count == 3]]
    for k in (1, 2):
        some = count == k
        corner, h = triangles[some], height[some]
        # turn each triangle so that the corner that is alone on its side comes first
        alone = np.argmax(kept[some] if k == 1 else ~kept[some], axis=1)
        order = (alone[:, None] + np.arange(3)) % 3
        row = np.arange(len(corner))[:, None]
        a, b, c = np.moveaxis(corner[row, order], 1, 0)
        ha, hb, hc = h[row, order].T
        ab = a + (ha / (ha - hb))[:, None] * (b - a)
        ac = a + (ha / (ha - hc))[:, None] * (c - a)
        if k == 1:
            out.append(np.stack([a, ab, ac], axis=1))
        else:
            out += [np.stack([ab, b, c], axis=1), np.stack([ab, c, ac], axis=1)]
    return np.concatenate(out)


def crossing_points(
    triangles: FloatArray, normal: FloatArray, offset: float, most: int
) -> FloatArray:
    """Where edges of triangles cross a plane, (m, 3), m; of about ``most`` triangles at most."""
    height = _heights(triangles, normal, offset)
    crossing = np.flatnonzero((height.min(axis=1) < 0) & (height.max(axis=1) > 0))
    crossing = crossing[:: max(1, len(crossing) // most)]
    corner, h = triangles[crossing], height[crossing]
    end, h_end = np.roll(corner, -1, axis=1), np.roll(h, -1, axis=1)
    through = h * h_end < 0
    share = h[through] / (h[through] - h_end[through])
    points: FloatArray = corner[through] + share[:, None] * (end[through] - corner[through])
    return points


def _heights(triangles: FloatArray, normal: FloatArray, offset: float) -> FloatArray:
    """Heights (n, 3) of corners above a plane, m; 0 where they are on it but for rounding."""
    height = triangles @ normal - offset
    height[np.abs(height) < SURE] = 0.0
    return height


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
