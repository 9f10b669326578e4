"""Whether triangles bound a solid, and if not, the fault and its place.

Sound means: every edge belongs to exactly two triangles that run through it in opposite directions;
every body is wound counter-clockwise seen from outside, or is a cavity in another; no triangle
passes through another, and bodies do not overlap. Crossings are found by exact tests of all
triangles near each other, overlaps by winding numbers on both sides of sampled faces.

By hand, because no library finds crossings: trimesh (``is_volume``) and manifold3d (``status``)
both accept two boxes that pass through each other (tests/test_bad_meshes.py), and neither gives a
place.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner.shapes.base import LARGEST
from planner.shapes.meshes.nearest_triangle import edge_table
from planner.shapes.meshes.triangles import COVERED, TOUCHING, cover, crossings, winding_number
from planner.spatial import FloatArray, IntArray

__all__ = [
    "MOST_TRIANGLES",
    "Fault",
    "bodies_of",
    "body_volumes",
    "directed_edges",
    "faults_of",
    "size_fault",
]

MOST_TRIANGLES = 200_000
"""Largest number of triangles: enough for every detail that a fingertip feels."""

THINNEST = 1e-3
"""Smallest longest extent (m) that is accepted: a smaller object cannot be grasped."""

FLAT = 1e-6
"""Fraction of its bounding box below which the volume of the largest body is none."""

PROBED_FACES = 24
"""Faces per body, the largest ones, on both sides of which the winding number is taken."""

PROBED_BODIES = 200
"""Bodies that are probed, at most; more are tested against crossings only."""

PROBE_OFFSET = 2e-6
"""Distance (m) of a probe from its face: far above rounding, far below a wall."""

COVER_POINTS = 20_000
"""Points on the surface, at least about, by which triangles that come near each other are found."""

PAIRS_AT_ONCE = 500_000
"""Pairs of triangles that are tested at once: some 200 MB."""


@dataclass(frozen=True, kw_only=True)
class Fault:
    """One thing that is wrong.

    Attributes:
        what: In words, with count and place.
        repairable: Whether ``repair=True`` tries to mend it.
        remedy: What else the user can do; "" if nothing is to be said.
    """

    what: str
    repairable: bool
    remedy: str = ""


def size_fault(vertices: FloatArray) -> Fault | None:
    """Whether the size can be meant in metres."""
    extent = float(np.ptp(vertices, axis=0).max())
    if extent > LARGEST:
        return Fault(
            what=f"is {extent:.4g} m long, more than {LARGEST:g} m",
            repairable=False,
            remedy="if the file is in millimetres, give scale 0.001 (FILE*0.001)",
        )
    if extent < THINNEST:
        return Fault(
            what=f"is {1e3 * extent:.4g} mm long, less than {1e3 * THINNEST:g} mm",
            repairable=False,
            remedy="give a larger scale (FILE*1000)",
        )
    return None


def faults_of(vertices: FloatArray, faces: IntArray) -> tuple[Fault, ...]:
    """What is wrong with triangles as the surface of a solid; empty if nothing.

    Args:
        vertices: (n, 3), m, finite; merged where equal.
        faces: (m, 3), indices of vertices, at least one, at most ``MOST_TRIANGLES``.
    """
    wrong = _edge_faults(vertices, faces)
    if wrong:
        return wrong
    volumes = np.abs(body_volumes(vertices, faces, bodies_of(faces)))
    box = float(np.prod(np.ptp(vertices, axis=0)))
    if float(volumes.max()) <= FLAT * box:
        return (Fault(what="it is flat: it encloses no volume", repairable=False),)
    crossing = _crossing_fault(vertices, faces)
    return (crossing,) if crossing else _side_faults(vertices, faces)


def directed_edges(faces: IntArray) -> tuple[IntArray, IntArray]:
    """Tails and heads (3 m,) of the edges of all faces, face after face."""
    return faces.ravel(), np.roll(faces, -1, axis=1).ravel()


def _edge_faults(vertices: FloatArray, faces: IntArray) -> tuple[Fault, ...]:
    tail, head = directed_edges(faces)
    n = len(vertices)
    undirected = np.minimum(tail, head) * n + np.maximum(tail, head)
    keys, of_edge, counts = np.unique(undirected, return_inverse=True, return_counts=True)
    out = []

    def place(edge: int) -> str:
        middle = vertices[[keys[edge] // n, keys[edge] % n]].mean(axis=0)
        return "({:.4g}, {:.4g}, {:.4g}) m".format(*middle)

    if (counts == 1).any():
        edges = np.flatnonzero(counts == 1)
        out.append(
            Fault(
                what=f"it is not closed: {len(edges)} open edge(s), the first at {place(edges[0])}",
                repairable=True,
            )
        )
    if (counts > 2).any():
        edges = np.flatnonzero(counts > 2)
        out.append(
            Fault(
                what=f"{len(edges)} edge(s) are of more than two triangles (non-manifold), the "
                f"first at {place(edges[0])}",
                repairable=True,
            )
        )
    forward = np.bincount(of_edge, weights=np.where(tail < head, 1, -1), minlength=len(keys))
    uneven = np.flatnonzero((counts == 2) & (forward != 0))
    if len(uneven):
        out.append(
            Fault(
                what=f"neighbouring triangles are wound in opposite senses at {len(uneven)} "
                f"edge(s), the first at {place(uneven[0])}",
                repairable=True,
            )
        )
    return tuple(out)


def body_volumes(vertices: FloatArray, faces: IntArray, body: IntArray) -> FloatArray:
    """Signed volume of each body, m3: positive where its normals point outwards."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    sixth = np.einsum("nd,nd->n", a, np.cross(b, c)) / 6
    volumes: FloatArray = np.bincount(body, weights=sixth).astype(np.float64)
    return volumes


def bodies_of(faces: IntArray) -> IntArray:
    """Number (m,) of the body that each face is of: faces that share an edge are of one body."""
    from scipy.sparse import coo_array  # here, since SciPy loads slowly
    from scipy.sparse.csgraph import connected_components  # here, since SciPy loads slowly

    tail, head = directed_edges(faces)
    n = int(faces.max()) + 1
    edge = np.minimum(tail, head) * n + np.maximum(tail, head)
    _, edge = np.unique(edge, return_inverse=True)
    face = np.repeat(np.arange(len(faces)), 3)
    # faces and edges are the nodes of one graph
    size = len(faces) + int(edge.max()) + 1
    links = coo_array((np.ones(len(face)), (face, edge + len(faces))), shape=(size, size))
    labels: IntArray = connected_components(links, directed=False)[1][: len(faces)]
    return np.unique(labels, return_inverse=True)[1]


def _crossing_fault(vertices: FloatArray, faces: IntArray) -> Fault | None:
    """Triangles that pass through each other."""
    from scipy.spatial import cKDTree  # here, since SciPy loads slowly

    corners = vertices[faces]
    area = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    step = float(np.sqrt(area.sum() / 2 / max(COVER_POINTS, len(faces))))
    points, owner = cover(corners, step)
    near = cKDTree(points).query_pairs(2 * COVERED * step, output_type="ndarray")
    pairs = np.sort(owner[near], axis=1)
    pairs = np.unique(pairs[:, 0] * len(faces) + pairs[:, 1])
    first, second = pairs // len(faces), pairs % len(faces)
    keep = first != second
    first, second = first[keep], second[keep]
    crossing = np.zeros(len(first), dtype=bool)
    for start in range(0, len(first), PAIRS_AT_ONCE):
        part = slice(start, start + PAIRS_AT_ONCE)
        crossing[part] = _cross(corners[first[part]], corners[second[part]])
    folded = _folded(faces, corners)
    if not crossing.any() and not len(folded):
        return None
    count = int(crossing.sum()) + len(folded)
    at = corners[first[crossing]] if crossing.any() else corners[folded]
    place = "({:.4g}, {:.4g}, {:.4g}) m".format(*at[0].mean(axis=0))
    return Fault(
        what=f"it passes through itself: {count} pair(s) of triangles cross, the first near "
        f"{place}",
        repairable=False,
        remedy="unite overlapping parts in the program that made the mesh",
    )


def _cross(a: FloatArray, b: FloatArray) -> NDArray[np.bool_]:
    """Whether triangles a and b (n, 3 corners, 3) pass through each other, (n,) bool."""
    low, high = np.maximum(a.min(axis=1), b.min(axis=1)), np.minimum(a.max(axis=1), b.max(axis=1))
    out: NDArray[np.bool_] = (low <= high).all(axis=1)
    for one, other in ((a, b), (b, a)):
        some = np.flatnonzero(out)
        normal = np.cross(one[some, 1] - one[some, 0], one[some, 2] - one[some, 0])
        length = np.linalg.norm(normal, axis=1, keepdims=True)
        normal /= np.where(length > 0, length, 1.0)
        height = np.einsum("nkd,nd->nk", other[some] - one[some, :1], normal)
        both_sides = (height.min(axis=1) < -TOUCHING) & (height.max(axis=1) > TOUCHING)
        out[some[~both_sides]] = False
    some = np.flatnonzero(out)
    hit = np.zeros(len(some), dtype=bool)
    for one, other in ((a[some], b[some]), (b[some], a[some])):
        for k in range(3):
            hit |= crossings(one[:, k], one[:, (k + 1) % 3], other)
    out[some] = hit
    return out


def _folded(faces: IntArray, corners: FloatArray) -> IntArray:
    """Faces (k,) that lie flat on a neighbour: opposite normals and the same side of the edge."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    unit = normals / np.where(length > 0, length, 1.0)
    across = edge_table(faces)
    opposite = np.einsum("md,mkd->mk", unit, unit[across]) < -1 + 1e-12
    middle = corners.mean(axis=1)
    edges = np.roll(corners, -1, axis=1) - corners
    inward = np.cross(unit[:, None], edges)
    theirs = np.einsum("mkd,mkd->mk", inward, middle[across] - corners)
    return np.flatnonzero((opposite & (theirs > 0)).any(axis=1))


def _side_faults(vertices: FloatArray, faces: IntArray) -> tuple[Fault, ...]:
    """Bodies that are inside out, or overlap, by winding numbers beside their largest faces."""
    corners = vertices[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(cross, axis=1)
    body = bodies_of(faces)
    order = np.lexsort((-area, body))
    starts = np.flatnonzero(np.diff(body[order], prepend=-1))[:PROBED_BODIES]
    rank = np.arange(len(order)) - np.repeat(
        np.flatnonzero(np.diff(body[order], prepend=-1)), np.bincount(body)
    )
    probed = order[(rank < PROBED_FACES) & (body[order] < len(starts)) & (area[order] > 0)]
    middle, normal = corners[probed].mean(axis=1), cross[probed] / area[probed, None]
    outside = np.round(winding_number(middle + PROBE_OFFSET * normal, corners))
    inside = np.round(winding_number(middle - PROBE_OFFSET * normal, corners))
    good = (outside == 0) & (inside == 1)
    if good.all():
        return ()
    at = "({:.4g}, {:.4g}, {:.4g}) m".format(*middle[np.flatnonzero(~good)[0]])
    if (outside[~good] == -1).all() and (inside[~good] == 0).all():
        return (Fault(what=f"it is inside out (normals point inwards) at {at}", repairable=True),)
    return (
        Fault(
            what=f"several bodies overlap, or one lies inside another, at {at}",
            repairable=False,
            remedy="unite overlapping parts in the program that made the mesh",
        ),
    )
