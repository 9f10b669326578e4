"""A mesh as a few convex pieces that together cover it: MuJoCo collides convex geoms.

The solid is cut by planes into cells (``planner.shapes.cutting``), and a piece is the
convex hull of the solid within its cell. Every point of the solid is in a piece, convex parts keep
their true surface, and a piece exceeds the solid only where it bridges a concave part: by no more
than the tolerance, where cutting succeeds. Afterwards pieces are merged where their common hull
keeps the tolerance too.

MuJoCo's signed-distance geoms would need none of this, but search for contacts from many starting
points at every step. CoACD and V-HACD decompose meshes too, but bound no distance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from heapq import heappop, heappush

import numpy as np

from planner.shapes.base import Shape
from planner.shapes.cutting import Guards, cut
from planner.shapes.hulls import Hull, hull_of
from planner.shapes.mesh import Mesh
from planner.shapes.meshes.triangles import cover, moments
from planner.spatial import FloatArray, IntArray
from planner.system.disk_cache import read_arrays, write_arrays

TOLERANCE = 0.001
"""How far (m) a piece may reach out of the solid, about; ``Pieces.deviation`` is measured. A
smaller tolerance makes more pieces."""

PIECES_VERSION = "v4"
"""Part of the key in the cache; changes whenever the result does."""

MEASURED = 0.001
"""Distance (m) between the points by which the deviation is measured."""

BATCH = 500
"""Points that are measured at once."""

FEW = 30
"""Corners of a hull by which most pairs are found not to be joined."""

TOUCHING = 1e-4
"""Gap (m) between bounding boxes up to which two pieces are neighbours."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Pieces:
    """Convex polyhedra that together cover a mesh.

    Attributes:
        vertices: Of each piece, (n, 3), m, in the mesh's frame.
        faces: Of each piece, (m, 3), counter-clockwise seen from outside.
        deviation: How far (m) they reach out of the solid at most, measured at points on them.
    """

    vertices: tuple[FloatArray, ...]
    faces: tuple[IntArray, ...]
    deviation: float

    def __len__(self) -> int:
        """How many."""
        return len(self.vertices)


@lru_cache(maxsize=32)
def convex_pieces(mesh: Mesh) -> Pieces:
    """The pieces of a mesh; prepared once, kept in memory and on disk."""
    key = f"{PIECES_VERSION}-{mesh.digest}"
    stored = read_arrays("pieces", key)
    if stored is not None:
        try:
            known = _from_arrays(stored)
            parts = list(zip(known.vertices, known.faces, strict=True))
            if pieces_fit(mesh, mesh.vertices, parts, known.deviation):
                return known
        except (KeyError, ValueError, IndexError):
            pass  # of another form: computed again
    made = _make(mesh, TOLERANCE)
    write_arrays("pieces", key, _to_arrays(made))
    return made


def _make(mesh: Mesh, tolerance: float) -> Pieces:
    whole = hull_of(mesh.hull_vertices)
    if whole is None:  # never: a mesh has volume
        return Pieces(vertices=(mesh.vertices,), faces=(mesh.faces,), deviation=0.0)
    guards = Guards(mesh, whole, tolerance)
    hulls = merge(guards, cut(mesh, guards, whole, tolerance))
    return Pieces(
        vertices=tuple(hull.points for hull in hulls),
        faces=tuple(hull.faces for hull in hulls),
        deviation=deviation(mesh, hulls),
    )


def merge(guards: Guards, hulls: list[Hull]) -> list[Hull]:
    """Fewer hulls that cover the same and contain no more guards.

    Pairs of neighbours are joined, those first whose common hull adds the least volume.
    """
    alive = dict(enumerate(hulls))
    queue: list[tuple[float, int, int]] = []

    def consider(i: int, j: int) -> None:
        a, b = alive[i], alive[j]
        gap = np.maximum(
            a.points.min(axis=0) - b.points.max(axis=0), b.points.min(axis=0) - a.points.max(axis=0)
        )
        if gap.max() > TOUCHING:
            return
        # a hull of fewer points is inside the whole one: where it has guards, the whole one has
        few = hull_of(np.concatenate([_some(a.points), _some(b.points)]))
        if few is not None and len(guards.within(few)):
            return
        joint = hull_of(np.concatenate([a.points, b.points]))
        if joint is not None and len(guards.within(joint)) == 0:
            heappush(queue, (joint.volume - a.volume - b.volume, i, j))

    for i in alive:
        for j in range(i):
            consider(i, j)
    number = len(hulls)
    while queue:
        _, i, j = heappop(queue)
        if i not in alive or j not in alive:
            continue
        joint = hull_of(np.concatenate([alive.pop(i).points, alive.pop(j).points]))
        if joint is None:  # never: it was one when it was considered
            continue
        alive[number] = joint
        for other in list(alive)[:-1]:
            consider(number, other)
        number += 1
    return list(alive.values())


def _some(points: FloatArray) -> FloatArray:
    return points[:: max(1, len(points) // FEW)]


def deviation(mesh: Mesh, hulls: list[Hull]) -> float:
    """How far (m) hulls reach out of the solid, at points on them; >= 0.

    No point is farther from the surface than from the nearest of some points on it, so points are
    measured in that order until this bound is below what was found: the same as measuring all.
    """
    from scipy.spatial import cKDTree  # here, since SciPy loads slowly

    points = np.concatenate([cover(hull.triangles, MEASURED)[0] for hull in hulls])
    field = mesh.field()
    points = points[field.value(points) > -field.error]  # the others are inside
    on_surface, _ = cover(mesh.vertices[mesh.faces], MEASURED / 2)
    bounds, _ = cKDTree(on_surface).query(points)
    farthest = 0.0
    order = np.argsort(-bounds)
    for start in range(0, len(order), BATCH):
        batch = order[start : start + BATCH]
        if bounds[batch[0]] <= farthest:
            break
        farthest = max(farthest, float(mesh.signed_distance(points[batch]).max()))
    return farthest


def _to_arrays(made: Pieces) -> dict[str, FloatArray]:
    arrays = {f"vertices_{k}": v for k, v in enumerate(made.vertices)}
    arrays |= {f"faces_{k}": f.astype(np.float64) for k, f in enumerate(made.faces)}
    return arrays | {"number_and_deviation": np.array([len(made), made.deviation])}


def _from_arrays(arrays: dict[str, FloatArray]) -> Pieces:
    number, deviation = arrays["number_and_deviation"]
    if number > len(arrays):
        raise ValueError(f"{number} pieces in {len(arrays)} arrays")
    return Pieces(
        vertices=tuple(arrays[f"vertices_{k}"] for k in range(int(number))),
        faces=tuple(arrays[f"faces_{k}"].astype(np.int64) for k in range(int(number))),
        deviation=float(deviation),
    )


EXACT = 1e-6
"""Rounding (m, or share of a volume) by which pieces from the disk may differ from their mesh."""


def pieces_fit(
    mesh: Shape,
    corners: FloatArray,
    pieces: Sequence[tuple[FloatArray, IntArray]],
    deviation: float,
) -> bool:
    """Whether pieces are convex, cover a mesh, and reach out of it no farther than they say.

    Args:
        mesh: The mesh.
        corners: Its vertices (n, 3), m.
        pieces: Vertices (k, 3), m, and faces (m, 3) of each.
        deviation: How far (m) they are said to reach out of it.
    """
    if len(pieces) == 0 or not 0 <= deviation <= mesh.bounding_radius:
        return False
    covered = np.full(len(corners), np.inf)
    volume = 0.0
    for vertices, faces in pieces:
        if not _is_polyhedron(vertices, faces):
            return False
        hull = hull_of(vertices)
        if hull is None or abs(moments(vertices[faces])[0] / hull.volume - 1) > EXACT:
            return False
        if mesh.signed_distance(vertices).max() > deviation + EXACT:
            return False
        covered = np.minimum(covered, -hull.depths(corners))
        volume += hull.volume
    return bool(covered.max() <= EXACT and volume >= mesh.volume * (1 - EXACT))


def _is_polyhedron(vertices: FloatArray, faces: IntArray) -> bool:
    """Whether arrays are of the form of a polyhedron, with finite numbers."""
    if vertices.ndim != 2 or vertices.shape[1] != 3 or not np.isfinite(vertices).all():
        return False
    if faces.ndim != 2 or faces.shape[1] != 3 or len(faces) < 4:
        return False
    return bool(faces.min() >= 0 and faces.max() < len(vertices))
