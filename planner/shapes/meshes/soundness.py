"""Whether triangles bound a solid, and if not, the fault and its place.

Sound means: every edge belongs to exactly two triangles that run through it in opposite directions;
no triangle passes through another; every body is wound counter-clockwise seen from outside, or is
a cavity in another; bodies do not overlap. Crossings are found by exact tests of all triangles near
each other. Without them a body lies wholly inside or outside of another, which the winding number
of one point tells, and the sign of its volume tells which way it is wound.

By hand, because no library finds crossings: trimesh (``is_volume``) and manifold3d (``status``)
both accept two boxes that pass through each other (tests/test_bad_meshes.py), and neither gives a
place.

``overlapping_boxes`` finds pairs of boxes that overlap: a tree of boxes against itself, one level
at a time in NumPy. The boxes are sorted along a Morton curve; neighbours in that order form a
complete binary tree, and all pairs of one level are tested at once: 0.2 s of CPU for 200,000
triangles. coal finds the same pairs, but hands each over as a Python object, and on a closed
surface every triangle touches a dozen others. Pairs whose boxes overlap are tested exactly, but for
those that cannot cross: two that share an edge (unless one is folded onto the other), and two that
share a corner around which all triangles, seen along the mean normal, lie side by side and turn
once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner.shapes.base import LARGEST
from planner.shapes.meshes.triangles import TOUCHING, crossings, winding_number
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


Corners = tuple[NDArray[np.float32], NDArray[np.float32]]
"""Lower and upper corners (3, n) of the boxes of one level of the tree."""

GRID = 2**16 - 1
"""Cells along the longest extent by which boxes are sorted."""


def overlapping_boxes(low: FloatArray, high: FloatArray) -> tuple[IntArray, IntArray]:
    """Numbers (k,) and (k,) of all pairs of different boxes that overlap or touch, each pair once.

    Corners are rounded outwards to single precision, which may add pairs with a gap of 1e-7 of
    their coordinates.

    Args:
        low: Lower corners (n, 3).
        high: Upper corners (n, 3).
    """
    order = _morton_order(low + high)
    one = other = np.zeros(1, dtype=np.int64)
    for lower, upper in _levels(low[order], high[order])[1:]:
        unlike = one != other
        first = np.concatenate([2 * one, 2 * one, 2 * one + 1, 2 * one[unlike] + 1])
        second = np.concatenate([2 * other + 1, 2 * other, 2 * other + 1, 2 * other[unlike]])
        for d in range(3):
            hit = lower[d].take(first) <= upper[d].take(second)
            hit &= lower[d].take(second) <= upper[d].take(first)
            kept = np.flatnonzero(hit)
            first, second = first.take(kept), second.take(kept)
        one, other = first, second
    different = one != other
    return order[one[different]], order[other[different]]


def _levels(low: FloatArray, high: FloatArray) -> list[Corners]:
    """Boxes of each level, from the root down; the leaves are the given ones and empty ones."""
    n = len(low)
    leaves = 1 << max(0, n - 1).bit_length()
    lower = np.full((3, leaves), np.inf, dtype=np.float32)
    upper = np.full((3, leaves), -np.inf, dtype=np.float32)
    lower[:, :n] = np.nextafter(low.T.astype(np.float32), np.float32(-np.inf))
    upper[:, :n] = np.nextafter(high.T.astype(np.float32), np.float32(np.inf))
    levels = [(lower, upper)]
    while lower.shape[1] > 1:
        lower = np.minimum(lower[:, ::2], lower[:, 1::2])
        upper = np.maximum(upper[:, ::2], upper[:, 1::2])
        levels.append((lower, upper))
    return levels[::-1]


def _morton_order(points: FloatArray) -> IntArray:
    """Order (n,) of points (n, 3) along a Morton curve."""
    extent = float(np.ptp(points, axis=0).max())
    cells = ((points - points.min(axis=0)) * (GRID / max(extent, 1e-300))).astype(np.uint64)
    code = np.zeros(len(points), dtype=np.uint64)
    for d in range(3):
        code |= _spread(cells[:, d]) << np.uint64(d)
    return np.argsort(code)


def _spread(bits: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """The 16 bits of each number, two zeros between neighbours."""
    for shift, mask in (
        (32, 0x001F00000000FFFF),
        (16, 0x001F0000FF0000FF),
        (8, 0x100F00F00F00F00F),
        (4, 0x10C30C30C30C30C3),
        (2, 0x1249249249249249),
    ):
        bits = (bits | (bits << np.uint64(shift))) & np.uint64(mask)
    return bits


Pairs = tuple[IntArray, IntArray]

FLUSH = 1e-8
"""Distance (m) below which two triangles lie in one plane: rounding of a file in single precision.

Two surfaces so near to each other are no wall."""

UPRIGHT = 0.05
"""Cosine between the normal of each triangle at a corner and their mean, at least, in a fan that is
taken to be flat enough not to cross itself: far from the rounding of a triangle seen edge-on."""

PAIRS_AT_ONCE = 500_000
"""Pairs of triangles that are tested at once: some 200 MB."""


def near_pairs(vertices: FloatArray, faces: IntArray) -> Pairs:
    """Pairs (k,) and (k,) of triangles that may cross: at most one corner is shared.

    Args:
        vertices: (n, 3), m.
        faces: (m, 3), of a closed surface, consistently wound.
    """
    corners = [vertices[faces[:, k]] for k in range(3)]
    low = np.minimum(np.minimum(corners[0], corners[1]), corners[2])
    high = np.maximum(np.maximum(corners[0], corners[1]), corners[2])
    one, other = overlapping_boxes(low, high)
    shared = np.zeros(len(one), dtype=np.int8)
    at = np.zeros(len(one), dtype=np.int64)
    theirs = [faces[:, k].take(other) for k in range(3)]
    for k in range(3):
        mine = faces[:, k].take(one)
        for vertex in theirs:
            same = mine == vertex
            shared += same
            np.copyto(at, mine, where=same)
    maybe = (shared == 0) | ((shared == 1) & ~_flat_fans(vertices, faces)[at])
    return one[maybe], other[maybe]


def _flat_fans(vertices: FloatArray, faces: IntArray) -> NDArray[np.bool_]:
    """Vertices (n,) whose triangles cannot cross: all face one way, and together turn once."""
    n = len(vertices)
    corners = [vertices[faces[:, k]] for k in range(3)]
    normals = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    length = np.sqrt(np.einsum("nd,nd->n", normals, normals))
    unit = normals / np.where(length > 0, length, 1.0)[:, None]
    mean = np.empty((n, 3))
    for d in range(3):
        weights = np.concatenate([unit[:, d]] * 3)
        mean[:, d] = np.bincount(faces.T.ravel(), weights, n)
    size = np.sqrt(np.einsum("nd,nd->n", mean, mean))
    mean /= np.where(size > 0, size, 1.0)[:, None]
    turn, upright = np.zeros(n), np.ones(n, dtype=bool)
    for k in range(3):
        at = faces[:, k]
        axis = mean[at]
        u, v = corners[(k + 1) % 3] - corners[k], corners[(k + 2) % 3] - corners[k]
        facing = np.einsum("nd,nd->n", unit, axis)
        along = np.einsum("nd,nd->n", u, v)
        along -= np.einsum("nd,nd->n", u, axis) * np.einsum("nd,nd->n", v, axis)
        turn += np.bincount(at, np.arctan2(facing * length, along), n)
        upright[at[facing < UPRIGHT]] = False
    # a closed fan turns a whole number of times
    return upright & (turn < 3 * np.pi)


def crossing_pairs(corners: FloatArray, pairs: Pairs) -> Pairs:
    """Those of the pairs that pass through each other; touching is not crossing.

    Args:
        corners: (m, 3 corners, 3), m.
        pairs: Two numbers (k,) of triangles.
    """
    one, other = pairs
    hit = np.zeros(len(one), dtype=bool)
    for start in range(0, len(one), PAIRS_AT_ONCE):
        part = slice(start, start + PAIRS_AT_ONCE)
        hit[part] = _cross(corners[one[part]], corners[other[part]])
    return one[hit], other[hit]


def _both_sides(one: FloatArray, other: FloatArray) -> NDArray[np.bool_]:
    """Whether triangles ``other`` reach to both sides of the planes of triangles ``one``, (n,)."""
    heights = _heights(one, other)
    out: NDArray[np.bool_] = (heights.min(axis=1) < -TOUCHING) & (heights.max(axis=1) > TOUCHING)
    return out


def _heights(one: FloatArray, other: FloatArray) -> FloatArray:
    """Heights (n, 3), m, of the corners of ``other`` above the planes of ``one``."""
    normal = _unit_normals(one)
    heights: FloatArray = np.einsum("nkd,nd->nk", other - one[:, :1], normal)
    return heights


def _unit_normals(corners: FloatArray) -> FloatArray:
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    unit: FloatArray = normal / np.where(length > 0, length, 1.0)
    return unit


def _cross(a: FloatArray, b: FloatArray) -> NDArray[np.bool_]:
    """Whether triangles a and b (n, 3 corners, 3) pass through each other, (n,) bool."""
    out = np.ones(len(a), dtype=bool)
    for one, other in ((a, b), (b, a)):
        some = np.flatnonzero(out)
        out[some[~_both_sides(one[some], other[some])]] = False
    some = np.flatnonzero(out)
    hit = np.zeros(len(some), dtype=bool)
    for one, other in ((a[some], b[some]), (b[some], a[some])):
        for k in range(3):
            hit |= crossings(one[:, k], one[:, (k + 1) % 3], other)
    out[some] = hit
    return out


def flush_pairs(corners: FloatArray, pairs: Pairs) -> Pairs:
    """Those of the pairs that lie in one plane and overlap there; arguments as above."""
    one, other = pairs
    a, b = corners[one], corners[other]
    flat = (np.abs(_heights(a, b)).max(axis=1) < FLUSH) & _wide(a) & _wide(b)
    one, other, a, b = one[flat], other[flat], a[flat], b[flat]
    apart = np.zeros(len(one), dtype=bool)
    for mine, theirs in ((a, b), (b, a)):
        normal = _unit_normals(mine)
        for k in range(3):
            edge = mine[:, (k + 1) % 3] - mine[:, k]
            inward = np.cross(normal, edge)
            inward /= np.linalg.norm(inward, axis=1, keepdims=True)
            reach = np.einsum("nkd,nd->nk", theirs - mine[:, k, None], inward).max(axis=1)
            apart |= reach < FLUSH
    return one[~apart], other[~apart]


def _wide(corners: FloatArray) -> NDArray[np.bool_]:
    """Whether triangles (n, 3, 3) are more than lines, (n,)."""
    edges = np.roll(corners, -1, axis=1) - corners
    longest = np.linalg.norm(edges, axis=2).max(axis=1)
    twice = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    out: NDArray[np.bool_] = twice > FLUSH * longest
    return out


def folded_pairs(corners: FloatArray, across: tuple[IntArray, IntArray]) -> Pairs:
    """Triangles (k,) and (k,) that share an edge and lie on each other: folded by 180 degrees.

    Args:
        corners: (m, 3 corners, 3), m.
        across: ``paired_edges`` of the triangles.
    """
    unit = _unit_normals(corners)
    one, other = across[0] // 3, across[1] // 3
    opposite = np.flatnonzero(np.einsum("nd,nd->n", unit[one], unit[other]) < -1 + 1e-12)
    one, other, corner = one[opposite], other[opposite], across[0][opposite] % 3
    start = corners[one, corner]
    inward = np.cross(unit[one], corners[one, (corner + 1) % 3] - start)
    theirs = np.einsum("nd,nd->n", inward, corners[other].mean(axis=1) - start)
    return one[theirs > 0], other[theirs > 0]
