"""Cutting a mesh by planes until the convex hull of the solid in each cell keeps a tolerance.

Guards are points at the tolerance off the surface. A hull that reaches farther out of the solid
contains one. The cost of a plane counts two things: the guards in the hulls of its two sides, and
the pairs of surface points on one side whose straight line leaves the solid. The first says little
while a part is far from convex (the hull of half a ring still covers its hole), the second little
at the end.
"""

from __future__ import annotations

from dataclasses import dataclass
from heapq import heappop, heappush
from itertools import count

import numpy as np

from planner.shapes.hulls import Hull, clip, crossing_points, hull_of
from planner.shapes.mesh import Mesh
from planner.shapes.meshes.triangles import cover
from planner.spatial import FloatArray, IntArray

MAX_CELLS = 160
"""Cells at most: a mesh that needs more is left with pieces that reach farther than asked."""

SPACING = 2.0
"""Distance between guards, in tolerances."""

MAX_GUARDS = 40_000
"""Guards at most, about: on a large object they stand farther apart."""

FREE = 0.95
"""Least distance of a guard from the solid, in tolerances; points in concave corners are nearer."""

SHARES = np.arange(1, 10) / 10
"""Where planes across an axis are tried, as shares of the extent of the hull."""

GUARD_SHARES = np.array([0.25, 0.5, 0.75])
"""The same, as shares of the extent of the guards in it: a small hollow is cut where it is."""

LOCAL = 0.5
"""Extent of the guards, as share of that of the hull, below which a hollow is small."""

TANGENTS = 6
"""Tangent planes at guards that are tried per cut: they find the corners of a bracket."""

SURFACE_POINTS, PAIRS, ON_LINE = 250, 1000, 5
"""Surface points and pairs of them per cell, and points on the line between the two."""

FINALISTS = 6
"""Planes across axes, the best by pairs, that are judged by the guards in their hulls as well."""

SAMPLE = 200
"""Guards, and corners of the hull, by which a plane is judged."""

STRAIGHT_COST = 0.3
"""Cost (-) of separating a pair whose line is inside, relative to leaving one that is outside."""

VOLUME_COST = 0.3
"""Weight (-) of the volume of both hulls: of equal planes the one that cuts off more wins."""

THINNEST = 0.03
"""Smallest part that a plane may cut off, as share of the extent across it."""

ON_PLANE = 1e-6
"""Distance (m) up to which a point counts as on a plane: rounding."""

ON_SURFACE = 1e-9
"""Depth or height (m) up to which a corner of a cell is on the surface: rounding. Such corners span
the solid where a face of it is cut along, and alone they are a cell beside the solid."""


class Guards:
    """Points at the tolerance off a mesh, where convex pieces must not reach.

    Attributes:
        points: (n, 3), m.
        feet: (n, 3), m, the surface points that they stand on.
        normals: (n, 3), outward, there.
    """

    def __init__(self, mesh: Mesh, whole: Hull, tolerance: float) -> None:
        """Set them up, inside of the hull of the whole mesh."""
        corners = mesh.vertices[mesh.faces]
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        twice = np.linalg.norm(cross, axis=1)
        step = max(SPACING * tolerance, float(np.sqrt(twice.sum() / 2 / MAX_GUARDS)))
        feet, owner = cover(corners, step)
        # one of each cube is enough where triangles are smaller than a step
        _, one = np.unique(np.floor(feet / step), axis=0, return_index=True)
        one = one[twice[owner[one]] > 0]
        feet, owner = feet[one], owner[one]
        normals = cross[owner] / twice[owner, None]
        points = feet + tolerance * normals
        near = whole.inside(points)
        free = near[mesh.signed_distance(points[near]) > FREE * tolerance]
        self.points, self.feet, self.normals = points[free], feet[free], normals[free]

    def within(self, hull: Hull, among: IntArray | None = None) -> IntArray:
        """Indices of those in a hull, out of some indices or of all."""
        if among is None:
            return hull.inside(self.points)
        some: IntArray = among[hull.inside(self.points[among])]
        return some


@dataclass(frozen=True, kw_only=True, eq=False)
class Cell:
    """A convex part of space with the surface in it.

    Attributes:
        surface: Triangles (n, 3 corners, 3) of the mesh in the cell, m.
        walls: The cell itself.
        hull: Of the solid in the cell.
        bad: Indices of the guards in that hull.
    """

    surface: FloatArray
    walls: Hull
    hull: Hull
    bad: IntArray


def cut(mesh: Mesh, guards: Guards, whole: Hull, tolerance: float) -> list[Hull]:
    """Hulls of the solid in cells that fill all space; no hull contains a guard.

    Args:
        mesh: The solid.
        guards: Where no hull may reach.
        whole: Hull of the mesh.
        tolerance: m.
    """
    low, high = mesh.bounds
    margin = (high - low).max()
    grid = np.stack(np.meshgrid(*zip(low - margin, high + margin, strict=True)), axis=-1)
    walls = hull_of(grid.reshape(-1, 3))
    if walls is None:  # never: a solid has extent
        return [whole]
    done: list[Hull] = []
    number = count()
    first = Cell(
        surface=mesh.vertices[mesh.faces], walls=walls, hull=whole, bad=guards.within(whole)
    )
    # worst cells first: at the limit of pieces the best cut so far is returned
    queue = [(-_depth(guards, first), next(number), first)]
    while queue:
        _, _, cell = heappop(queue)
        plane = None
        if len(cell.bad) and len(queue) + len(done) + 2 <= MAX_CELLS:
            plane = _best_plane(mesh, guards, cell, tolerance)
        if plane is None:
            done.append(cell.hull)
            continue
        normal, offset = plane[:3], float(plane[3])
        below = half_of(mesh, guards, cell, normal, offset)
        above = half_of(mesh, guards, cell, -normal, -offset)
        if below is None or above is None:  # nothing was gained, nor would be by trying again
            done.append(cell.hull)
            continue
        for half in (below, above):
            heappush(queue, (-_depth(guards, half), next(number), half))
    return done


def _depth(guards: Guards, cell: Cell) -> float:
    """How deep (m) the deepest guard is in a cell's hull; 0 without any."""
    if len(cell.bad) == 0:
        return 0.0
    return float(cell.hull.depths(guards.points[cell.bad]).max())


def half_of(
    mesh: Mesh, guards: Guards, cell: Cell, normal: FloatArray, offset: float
) -> Cell | None:
    """The part of a cell with normal x <= offset; None if it holds nothing of the solid."""
    surface = clip(cell.surface, normal, offset)
    walls = hull_of(clip(cell.walls.triangles, normal, offset).reshape(-1, 3))
    if walls is None:
        return None
    # the solid in a cell is spanned by the surface in it and by the cell's corners in the solid
    height = mesh.signed_distance(walls.points)
    if len(surface) == 0 and not (height < -ON_SURFACE).any():
        return None
    corners = walls.points[height <= ON_SURFACE]
    hull = hull_of(np.concatenate([surface.reshape(-1, 3), corners]))
    if hull is None:
        return None
    return Cell(surface=surface, walls=walls, hull=hull, bad=guards.within(hull, cell.bad))


def _best_plane(mesh: Mesh, guards: Guards, cell: Cell, tolerance: float) -> FloatArray | None:
    """The plane (4,), normal and offset (m), to cut a cell by; None if there is none."""
    points = _spread(cell.surface)
    _, _, axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)
    axes = np.concatenate([axes, np.eye(3)])
    across = _across(cell.hull.points, axes, SHARES)
    bad = guards.points[cell.bad]
    if np.ptp(bad, axis=0).max() < LOCAL * np.ptp(cell.hull.points, axis=0).max():
        across = np.concatenate([across, _across(bad, axes, GUARD_SHARES)])
    planes = np.concatenate([across, _tangents(guards, cell, tolerance)])
    heights = cell.hull.points @ planes[:, :3].T
    low, high = heights.min(axis=0), heights.max(axis=0)
    thin = THINNEST * (high - low)
    useful = (planes[:, 3] > low + thin) & (planes[:, 3] < high - thin)
    if not useful.any():
        return None
    cost = _pair_cost(mesh, points, planes, tolerance)
    cost[~useful] = np.inf
    finalists = [*np.argsort(cost)[:FINALISTS], *range(len(across), len(planes))]
    best, least = None, np.inf
    for k in finalists:
        if np.isfinite(cost[k]):
            total = cost[k] + _hull_cost(guards, cell, points, planes[k])
            if total < least:
                best, least = planes[k], total
    return best


def _spread(triangles: FloatArray) -> FloatArray:
    """Points (n, 3) evenly over triangles, about ``SURFACE_POINTS``."""
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    twice = np.linalg.norm(cross, axis=1)
    points, _ = cover(triangles, float(np.sqrt(twice.sum() / 2 / SURFACE_POINTS)))
    if len(points) < 2 * SURFACE_POINTS:
        return points
    # triangles smaller than the spacing: one point of each, of some that are even by area
    share = (np.arange(SURFACE_POINTS) + 0.5) / SURFACE_POINTS
    pick = np.searchsorted(np.cumsum(twice) / twice.sum(), share)
    few: FloatArray = triangles[pick].mean(axis=1)
    return few


def _across(points: FloatArray, axes: FloatArray, shares: FloatArray) -> FloatArray:
    """Planes (n, 4) across axes (k, 3), at shares of the extent of points."""
    heights = points @ axes.T
    low, high = heights.min(axis=0), heights.max(axis=0)
    offsets = low + shares[:, None] * (high - low)  # (shares, k)
    normals = np.tile(axes, (len(shares), 1))
    return np.concatenate([normals, offsets.reshape(-1, 1)], axis=1)


def _tangents(guards: Guards, cell: Cell, tolerance: float) -> FloatArray:
    """Tangent planes (n, 4) of the surface under the deepest guards that differ."""
    feet, normals = guards.feet[cell.bad], guards.normals[cell.bad]
    depth = cell.hull.depths(guards.points[cell.bad])
    left = np.ones(len(feet), dtype=bool)
    planes = []
    for _ in range(TANGENTS):
        if not left.any():
            break
        k = int(np.argmax(np.where(left, depth, -np.inf)))
        normal, offset = normals[k], float(feet[k] @ normals[k])
        planes.append(np.append(normal, offset))
        same = (normals @ normal > 0.95) & (np.abs(feet @ normal - offset) < 2 * tolerance)
        left &= ~same
        left[k] = False
    return np.array(planes).reshape(-1, 4)


def _pair_cost(mesh: Mesh, points: FloatArray, planes: FloatArray, tolerance: float) -> FloatArray:
    """How much of the lines outside the solid planes leave uncut, in [0, 1], and what they spoil.

    Args:
        mesh: The solid.
        points: Surface points (n, 3) of the cell, m.
        planes: (k, 4).
        tolerance: m.
    """
    rng = np.random.default_rng(0)
    i, j = rng.integers(0, len(points), (2, PAIRS))
    share = (np.arange(ON_LINE) + 1) / (ON_LINE + 1)
    on_line = points[i, None] + share[:, None] * (points[j] - points[i])[:, None]
    values = mesh.field().value(on_line.reshape(-1, 3)).reshape(PAIRS, ON_LINE)
    outside = np.maximum(values.max(axis=1), 0.0)
    straight = outside < tolerance / 2
    # a point on a tangent plane belongs to the solid beneath it
    above = points @ planes[:, :3].T > planes[:, 3] + ON_PLANE
    together = above[i] == above[j]  # (PAIRS, k)
    left = outside @ together / max(float(outside.sum()), np.finfo(float).tiny)
    spoilt = 1.0 - together[straight].mean(axis=0) if straight.any() else np.zeros(len(planes))
    cost: FloatArray = left + STRAIGHT_COST * spoilt
    return cost


def _hull_cost(guards: Guards, cell: Cell, points: FloatArray, plane: FloatArray) -> float:
    """Share of the cell's guards that stay in a hull, and the volume of both hulls."""
    normal, offset = plane[:3], float(plane[3])
    some = guards.points[cell.bad[:: max(1, len(cell.bad) // SAMPLE)]]
    corners = cell.hull.points[:: max(1, len(cell.hull.points) // SAMPLE)]
    known = np.concatenate([points, corners])
    rim = crossing_points(cell.surface, normal, offset, SAMPLE // 3)
    height = known @ normal - offset
    bad, volume = 0, 0.0
    for side in (known[height > ON_PLANE], known[height < -ON_PLANE]):
        hull = hull_of(np.concatenate([side, rim]))
        if hull is not None:
            bad += len(hull.inside(some))
            volume += hull.volume
    return bad / len(some) + VOLUME_COST * volume / cell.hull.volume
