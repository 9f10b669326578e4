"""Whether triangles bound a solid, and if not, the fault and its place.

Sound means: every edge belongs to exactly two triangles that run through it in opposite directions;
no triangle passes through another; every body is wound counter-clockwise seen from outside, or is
a cavity in another; bodies do not overlap. Crossings are found by exact tests of all triangles near
each other. Without them a body lies wholly inside or outside of another, which the winding number
of one point tells, and the sign of its volume tells which way it is wound.

By hand, because no library finds crossings: trimesh (``is_volume``) and manifold3d (``status``)
both accept two boxes that pass through each other (tests/test_bad_meshes.py), and neither gives a
place.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planner.shapes.base import LARGEST
from planner.shapes.meshes.crossing import (
    crossing_pairs,
    flush_pairs,
    folded_pairs,
    near_pairs,
    overlapping_boxes,
)
from planner.shapes.meshes.triangles import winding_number
from planner.spatial import FloatArray, IntArray


def directed_edges(faces: IntArray) -> tuple[IntArray, IntArray]:
    """Tails and heads (3 m,) of the edges of all faces, face after face."""
    return faces.ravel(), faces[:, [1, 2, 0]].ravel()


def undirected_edges(faces: IntArray) -> IntArray:
    """A number (3 m,) for each edge of all faces, the same whichever way it is run through."""
    tail, head = directed_edges(faces)
    keys: IntArray = np.minimum(tail, head) * (int(faces.max()) + 1) + np.maximum(tail, head)
    return keys


def paired_edges(faces: IntArray) -> tuple[IntArray, IntArray] | None:
    """Two edges (e,) and (e,), of ``directed_edges``, for each of a closed surface.

    None if an edge is not of exactly two triangles that run through it in opposite directions.
    """
    keys = undirected_edges(faces)
    order = np.argsort(keys)
    if len(order) % 2:
        return None
    one, other = order[::2], order[1::2]
    if (keys[one] != keys[other]).any() or (np.diff(keys[one]) == 0).any():
        return None
    tail, head = directed_edges(faces)
    return (one, other) if (tail[one] == head[other]).all() else None


def joined(one: IntArray, other: IntArray, size: int) -> IntArray:
    """Label (size,) of each of ``size`` things, the same for those that a chain of pairs joins.

    Args:
        one: Number (k,) of the first of each pair.
        other: Number (k,) of its second.
        size: How many things there are.
    """
    from scipy.sparse import coo_array  # here, since SciPy loads slowly
    from scipy.sparse.csgraph import connected_components

    links = coo_array((np.ones(len(one), dtype=np.int8), (one, other)), shape=(size, size))
    labels: IntArray = connected_components(links, directed=False)[1].astype(np.int64)
    return labels


def bodies_of(faces: IntArray) -> IntArray:
    """Number (m,) of the body that each face is of: faces that share an edge are of one body."""
    keys = undirected_edges(faces)
    order = np.argsort(keys)
    same = np.flatnonzero(np.diff(keys[order]) == 0)
    return joined(order[same] // 3, order[same + 1] // 3, len(faces))


def body_volumes(vertices: FloatArray, faces: IntArray, body: IntArray) -> FloatArray:
    """Signed volume of each body, m3: positive where its normals point outwards."""
    centred = vertices - vertices.mean(axis=0)  # far from the origin, rounding is as large
    a, b, c = (centred[faces[:, k]] for k in range(3))
    sixth = np.einsum("nd,nd->n", a, np.cross(b, c)) / 6
    volumes: FloatArray = np.bincount(body, weights=sixth).astype(np.float64)
    return volumes


MOST_TRIANGLES = 1_000_000
"""Largest number of triangles: a scan's 300,000 and more, loaded and checked in some 5 s of CPU and
1.5 GB (tests/test_large_meshes.py)."""

THINNEST = 1e-3
"""Smallest longest extent (m) that is accepted: a smaller object cannot be grasped."""

FLAT = 1e-6
"""Fraction of its bounding box below which the volume of the largest body is none."""

WITNESSES = 3
"""Faces of a body, its largest ones, whose middles tell by majority whether it is in another."""


@dataclass(frozen=True, kw_only=True)
class Fault:
    """One thing that is wrong.

    Attributes:
        what: In words, with count and place.
        remedy: What else the user can do; "" if nothing is to be said.
    """

    what: str
    remedy: str = ""


def size_fault(vertices: FloatArray) -> Fault | None:
    """Whether the size can be meant in metres."""
    extent = float(np.ptp(vertices, axis=0).max())
    if extent > LARGEST:
        return Fault(
            what=f"is {extent:.4g} m long, more than {LARGEST:g} m",
            remedy="if the file is in millimetres, give scale 0.001 (FILE*0.001)",
        )
    if extent < THINNEST:
        return Fault(
            what=f"is {1e3 * extent:.4g} mm long, less than {1e3 * THINNEST:g} mm",
            remedy="give a larger scale (FILE*1000)",
        )
    return None


def faults_of(vertices: FloatArray, faces: IntArray) -> tuple[Fault, ...]:
    """What is wrong with triangles as the surface of a solid; empty if nothing.

    Args:
        vertices: (n, 3), m, finite; merged where equal.
        faces: (m, 3), indices of vertices, at least one, at most ``MOST_TRIANGLES``.
    """
    across = paired_edges(faces)
    if across is None:
        return _edge_faults(vertices, faces)
    body = bodies_of(faces)
    volumes = body_volumes(vertices, faces, body)
    box = float(np.prod(np.ptp(vertices, axis=0)))
    if float(np.abs(volumes).max()) <= FLAT * box:
        return (Fault(what="it is flat: it encloses no volume"),)
    corners, near = vertices[faces], near_pairs(vertices, faces)
    one, _ = crossing_pairs(corners, near)
    folded, _ = folded_pairs(corners, across)
    if len(one) + len(folded):
        at = _place(corners[(one if len(one) else folded)[0]])
        count = len(one) + len(folded)
        return (
            Fault(
                what=f"it passes through itself: {count} pair(s) of triangles cross, the first "
                f"near {at}"
            ),
        )
    if len(volumes) > 1:
        unlike = body[near[0]] != body[near[1]]
        one, _ = flush_pairs(corners, (near[0][unlike], near[1][unlike]))
        if len(one):
            return (_overlap(corners[one[0]]),)
    return _side_faults(corners, body, volumes)


def _place(corners: FloatArray) -> str:
    return "({:.4g}, {:.4g}, {:.4g}) m".format(*corners.mean(axis=0))


def _overlap(corners: FloatArray) -> Fault:
    return Fault(
        what=f"several bodies overlap, or one lies inside another, at {_place(corners)}",
    )


def _edge_faults(vertices: FloatArray, faces: IntArray) -> tuple[Fault, ...]:
    tail, head = directed_edges(faces)
    n = int(faces.max()) + 1
    keys, of_edge, counts = np.unique(
        undirected_edges(faces), return_inverse=True, return_counts=True
    )
    out = []

    def place(edge: int) -> str:
        middle = vertices[[keys[edge] // n, keys[edge] % n]].mean(axis=0)
        return "({:.4g}, {:.4g}, {:.4g}) m".format(*middle)

    if (counts == 1).any():
        edges = np.flatnonzero(counts == 1)
        out.append(
            Fault(
                what=f"it is not closed: {len(edges)} open edge(s), the first at {place(edges[0])}",
            )
        )
    if (counts > 2).any():
        edges = np.flatnonzero(counts > 2)
        out.append(
            Fault(
                what=f"{len(edges)} edge(s) are of more than two triangles (non-manifold), the "
                f"first at {place(edges[0])}",
            )
        )
    forward = np.bincount(of_edge, weights=np.where(tail < head, 1, -1), minlength=len(keys))
    uneven = np.flatnonzero((counts == 2) & (forward != 0))
    if len(uneven):
        out.append(
            Fault(
                what=f"neighbouring triangles are wound in opposite senses at {len(uneven)} "
                f"edge(s), the first at {place(uneven[0])}",
            )
        )
    return tuple(out)


def _side_faults(corners: FloatArray, body: IntArray, volumes: FloatArray) -> tuple[Fault, ...]:
    """Bodies that are inside out, or lie in another without being a cavity of it."""
    around = surroundings(corners, body, len(volumes))
    good = around == np.where(volumes > 0, 0, 1)
    if good.all():
        return ()
    first = corners[np.flatnonzero(~good[body])[0]]
    # all would be well if every face were turned
    if (-around == np.where(volumes > 0, 1, 0))[~good].all():
        return (Fault(what=f"it is inside out (normals point inwards) at {_place(first)}"),)
    return (_overlap(first),)


def surroundings(corners: FloatArray, body: IntArray, count: int) -> IntArray:
    """How often the other bodies surround each body (count,): 0 for one that lies apart.

    Arguments as of ``nested``.
    """
    around = np.zeros(count, dtype=np.int64)
    for inner, _, winding in nested(corners, body, count):
        around[inner] += winding
    return around


def nested(corners: FloatArray, body: IntArray, count: int) -> list[tuple[int, int, int]]:
    """Bodies that lie in others: numbers of the inner and the outer, and how often it winds around.

    Args:
        corners: (m, 3 corners, 3), m.
        body: Number (m,) of the body of each triangle.
        count: Number of bodies.
    """
    if count == 1:
        return []
    order = np.argsort(body, kind="stable")
    starts = np.searchsorted(body[order], np.arange(count + 1))
    low = np.minimum.reduceat(corners[order].min(axis=1), starts[:-1])
    high = np.maximum.reduceat(corners[order].max(axis=1), starts[:-1])
    one, other = overlapping_boxes(low, high)
    out = []
    for inner, outer in zip(np.r_[one, other].tolist(), np.r_[other, one].tolist(), strict=True):
        if (low[inner] < low[outer]).any() or (high[inner] > high[outer]).any():
            continue
        own = corners[order[starts[inner] : starts[inner + 1]]]
        size = np.linalg.norm(np.cross(own[:, 1] - own[:, 0], own[:, 2] - own[:, 0]), axis=1)
        witnesses = own[np.argsort(-size)[:WITNESSES]].mean(axis=1)
        theirs = corners[order[starts[outer] : starts[outer + 1]]]
        winding = int(np.median(np.round(winding_number(witnesses, theirs))))
        if winding:
            out.append((inner, outer, winding))
    return out
