"""The directions in which a grasp resists least, quickly: what an optimiser should work on.

The hull of unit contact wrenches (normal forces sum to 1, torques over ``length``) is taken with
coarse friction pyramids; the outward normals of its nearest faces are the directions. The round
cones resist a little more in each of them, and what they resist at least is epsilon: bounds that
are proven come from ``planner.quality.ball``.

Faces are found by walking from face to face over their ridges. Directions u with w_k . u <= 1 for
all wrenches w_k (about their mean) are a polytope whose vertices are the faces of the hull: at a
vertex six wrenches have w_k . u = 1, and leaving one of them behind leads along an edge to the
neighbour (Avis, Fukuda, "A pivoting algorithm for convex hulls and vertex enumeration of
arrangements and polyhedra", 1992). The four edges of a friction pyramid lie in a plane, and
opposite pads are parallel, so faces often hold more than six wrenches. The walk sees wrenches that
are shifted by next to nothing, so that each vertex has six; its faces are then computed from the
wrenches as they are, and the parts of one face become one.

Qhull, which is made for many points, takes 0.7 ms for the 16 wrenches of four contacts, the
compiled walk a sixth of that. Where it is not compiled, or goes astray, Qhull answers.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from planner.contacts import cone_edges
from planner.numerics.kernels import kernel
from planner.spatial import FloatArray, cross

MOST_WALKED = 32
"""Wrenches (-) beyond which Qhull is asked at once: 8 contacts with 4 edges."""

SHIFT = 1e-8
"""Largest shift of a limit w_k . u <= 1 (-): far above rounding, far below any use."""

PARALLEL = 1e-9
"""A wrench that nears a limit more slowly than this, over its size and the direction's (-), does
not: it lies in the ridge."""

FLAT = 1e-14
"""Wrenches span no volume where a pivot of their scatter is below this share of its trace (-)."""

SAME = 1e-12
"""Faces with normals whose cosine is within this of 1 are one: 1.4 microradians (-)."""

EVEN = 1e-7
"""Distances that follow each other this closely, as those of symmetrical grasps, are one (-)."""

_SHIFTS = SHIFT * np.random.default_rng(0).uniform(0.0, 1.0, MOST_WALKED)

_TIES = np.random.default_rng(1).normal(size=6)
"""Faces at one distance come in the order of their normals' products with this."""


def hull_faces(wrenches: FloatArray) -> FloatArray:
    """Faces (k, 7) of the hull of wrenches (m, 6), nearest first, each once.

    A row is the outward unit normal, and minus the distance of its plane from the origin: above
    zero where the origin is outside. None where the wrenches span no volume.
    """
    few = len(wrenches) <= MOST_WALKED
    faces, whole = walked_faces(wrenches, _SHIFTS) if few else (_NONE, False)
    if not whole:
        faces = _qhull_faces(wrenches)
    faces = faces[np.argsort(-faces[:, 6], kind="stable")]
    return distinct_faces(faces, _TIES)


_NONE = np.zeros((0, 7))


def _qhull_faces(wrenches: FloatArray) -> FloatArray:
    """Faces (k, 7), some of them many times; none where the wrenches span no volume."""
    from planner.system.scipy_parts import ConvexHull, QhullError  # here: SciPy loads slowly

    scatter = wrenches - wrenches.sum(axis=0) / len(wrenches)
    values = np.linalg.eigvalsh(scatter.T @ scatter)
    if not values[0] > FLAT * values.sum():
        return _NONE

    try:
        return np.asarray(ConvexHull(wrenches).equations)
    except QhullError:
        return _NONE


def _walked_by_qhull(wrenches: FloatArray, shifts: FloatArray) -> tuple[FloatArray, bool]:
    """``walked_faces`` where it is not compiled."""
    return _qhull_faces(wrenches), True


@kernel(_walked_by_qhull)
def walked_faces(wrenches: FloatArray, shifts: FloatArray) -> tuple[FloatArray, bool]:
    """Faces (k, 7) of the hull in any order, some of them many times, and whether these are all.

    Args:
        wrenches: (m, 6), m at most ``MOST_WALKED``.
        shifts: (``MOST_WALKED``,), how far each limit is moved in.
    """
    m = len(wrenches)
    none = np.zeros((0, 7))
    p = np.zeros((m, 6))
    size = 0.0
    for i in range(6):
        mean = 0.0
        for k in range(m):
            mean += wrenches[k, i]
        for k in range(m):
            p[k, i] = wrenches[k, i] - mean / m
            size += p[k, i] * p[k, i]
    if not 0.0 < size < np.inf:
        return none, size == 0.0
    for k in range(m):
        for i in range(6):
            p[k, i] *= np.sqrt(m / size)

    # whether they span a volume: pivots of the scatter, the largest first
    scatter = np.zeros((6, 6))
    for k in range(m):
        for i in range(6):
            for j in range(6):
                scatter[i, j] += p[k, i] * p[k, j]
    least = FLAT * m
    for _ in range(6):
        best = 0
        for i in range(6):
            if scatter[i, i] > scatter[best, best]:
                best = i
        pivot = scatter[best, best]
        if not pivot > least:
            return none, True
        for i in range(6):
            if i != best:
                part = scatter[i, best] / pivot
                for j in range(6):
                    scatter[i, j] -= part * scatter[best, j]
        for i in range(6):
            scatter[i, best] = scatter[best, i] = 0.0

    most = m * (m - 4) * (m - 5) // 6  # McMullen's upper bound theorem, in six dimensions
    places = 64
    while places < 6 * most:  # twice the ridges
        places *= 2
    # the first vertex: from u = 0 along what is normal to the corners met so far
    corners = np.empty((most, 6), dtype=np.int64)
    slacks = np.empty((most, m))
    inverse = np.empty((most, 6, 6))  # rows d_j: w_i . d_j is 1 for i = j, else 0
    met = np.zeros(m, dtype=np.bool_)
    share = np.zeros(6)
    rates = np.zeros(m)
    for i in range(6):
        for j in range(6):
            inverse[0, i, j] = 0.0
        inverse[0, i, i] = 1.0
    for k in range(m):
        slacks[0, k] = 1.0 - shifts[k]
    for step in range(6):
        first, nearest = -1, np.inf
        least = 0.0
        for i in range(6):
            least = max(least, PARALLEL * abs(inverse[0, step, i]))
        for k in range(m):
            rates[k] = 0.0
            for i in range(6):
                rates[k] += p[k, i] * inverse[0, step, i]
            if not met[k] and rates[k] > least and slacks[0, k] < nearest * rates[k]:
                first, nearest = k, slacks[0, k] / rates[k]
        if first < 0:
            return none, False
        met[first] = True
        corners[0, step] = first
        for k in range(m):
            slacks[0, k] -= nearest * rates[k]
        for j in range(6):
            share[j] = 0.0
            for i in range(6):
                share[j] += p[first, i] * inverse[0, j, i]
        for i in range(6):
            inverse[0, step, i] /= share[step]
            for j in range(6):
                if j != step:
                    inverse[0, j, i] -= share[j] * inverse[0, step, i]

    # over each ridge that only one simplex has, to the other one
    keys = np.zeros(places, dtype=np.int64)
    sides = np.zeros(places, dtype=np.int8)
    ridges = np.empty((3 * most, 3), dtype=np.int64)
    count, known, next_ridge, new = 1, 0, 0, 0
    while True:
        mask = 0
        for j in range(6):
            mask |= 1 << corners[new, j]
        for j in range(6):
            ridge = mask ^ (1 << corners[new, j])
            place = ((ridge * 0x9E3779B1) >> 13) & (places - 1)
            while keys[place] != 0 and keys[place] != ridge:
                place = (place + 1) & (places - 1)
            keys[place] = ridge
            sides[place] += 1
            if sides[place] > 2 or known == 3 * most:
                return none, False
            if sides[place] == 1:
                ridges[known, 0], ridges[known, 1], ridges[known, 2] = new, j, place
                known += 1
        while next_ridge < known and sides[ridges[next_ridge, 2]] == 2:
            next_ridge += 1
        if next_ridge == known:
            break
        if count == most:
            return none, False
        old, leaving = ridges[next_ridge, 0], ridges[next_ridge, 1]
        least = 0.0
        for i in range(6):
            least = max(least, PARALLEL * abs(inverse[old, leaving, i]))
        entering, nearest = -1, np.inf
        for k in range(m):
            rates[k] = 0.0
            for i in range(6):
                rates[k] -= p[k, i] * inverse[old, leaving, i]
            if rates[k] > least and slacks[old, k] < nearest * rates[k]:
                entering, nearest = k, slacks[old, k] / rates[k]
        if entering < 0:
            return none, False
        new, count = count, count + 1
        for k in range(m):
            slacks[new, k] = slacks[old, k] - nearest * rates[k]
        for j in range(6):
            corners[new, j] = corners[old, j]
            share[j] = 0.0
            for i in range(6):
                share[j] += p[entering, i] * inverse[old, j, i]
        corners[new, leaving] = entering
        slacks[new, entering] = 0.0
        for i in range(6):
            part = inverse[old, leaving, i] / share[leaving]
            for j in range(6):
                inverse[new, j, i] = inverse[old, j, i] - share[j] * part
            inverse[new, leaving, i] = part

    faces = np.zeros((count, 7))
    u = np.zeros(6)
    for face in range(count):
        for i in range(6):
            u[i] = 0.0
            for j in range(6):
                u[i] += inverse[face, j, i]
        for j in range(6):  # what rounding has left, once more
            share[j] = 1.0
            for i in range(6):
                share[j] -= p[corners[face, j], i] * u[i]
        total = 0.0
        for i in range(6):
            for j in range(6):
                u[i] += share[j] * inverse[face, j, i]
            total += u[i] * u[i]
        for i in range(6):
            faces[face, i] = u[i] / np.sqrt(total)
        reach = -np.inf
        for k in range(m):
            along = 0.0
            for i in range(6):
                along += wrenches[k, i] * faces[face, i]
            reach = max(reach, along)
        faces[face, 6] = -reach
    return faces, True


def _distinct(faces: FloatArray, ties: FloatArray) -> FloatArray:
    """``distinct_faces`` where it is not compiled."""
    level = np.cumsum(np.diff(-faces[:, 6], prepend=-np.inf) > EVEN)
    faces = faces[np.lexsort((faces[:, :6] @ ties, level))]
    new = np.ones(len(faces), dtype=np.bool_)
    new[1:] = ~((faces[1:, :6] * faces[:-1, :6]).sum(axis=1) > 1.0 - SAME)
    return np.asarray(faces[new])


@kernel(_distinct)
def distinct_faces(faces: FloatArray, ties: FloatArray) -> FloatArray:
    """Faces (k, 7), each once; those at one distance in the order of their products with ``ties``.

    Args:
        faces: (n, 7), nearest first.
        ties: (6,).
    """
    n = len(faces)
    tie = np.zeros(n)
    order = np.zeros(n, dtype=np.int64)
    begin = 0
    for i in range(n):
        for j in range(6):
            tie[i] += faces[i, j] * ties[j]
        if i > 0 and faces[i - 1, 6] - faces[i, 6] > EVEN:
            begin = i
        place = i
        while place > begin and tie[order[place - 1]] > tie[i]:
            order[place] = order[place - 1]
            place -= 1
        order[place] = i
    out = np.zeros((n, 7))
    kept = 0
    for i in range(n):
        cosine = 0.0
        if i > 0:
            for j in range(6):
                cosine += faces[order[i - 1], j] * faces[order[i], j]
        if not cosine > 1.0 - SAME:
            for j in range(7):
                out[kept, j] = faces[order[i], j]
            kept += 1
    return out[:kept]


EDGES = 4
"""Sides of the pyramids: Qhull takes 1 ms with four, 4 ms with eight."""

APART = float(np.cos(np.deg2rad(20.0)))
"""Directions closer than this cosine are one."""


def weakest_directions(
    points: FloatArray, inward: FloatArray, mu: float, length: float, count: int
) -> FloatArray:
    """Up to ``count`` unit directions (k, 6), weakest first, at least 20 degrees apart.

    None where the wrenches span no volume.

    Args:
        points: Contact points (n, 3) about the reference point, m.
        inward: Unit normals into the object (n, 3).
        mu: Friction (-).
        length: Characteristic length, m.
        count: How many.
    """
    faces = wrench_faces(points, inward, mu, length)[:, :6]
    return faces[first_apart(faces, count)]


def wrench_faces(points: FloatArray, inward: FloatArray, mu: float, length: float) -> FloatArray:
    """Faces (k, 7) of the hull, nearest first, each once: outward unit normal, minus its distance.

    None where the wrenches span no volume. Arguments are those of ``weakest_directions``.
    """
    return hull_faces(pyramid_wrenches(points, inward, float(mu), float(length), sides_of(EDGES)))


@lru_cache(4)
def sides_of(edges: int) -> FloatArray:
    """Tangential force (k, 2) of each edge of a pyramid at a friction of 1."""
    sides = np.ascontiguousarray(cone_edges(1.0, 0.0, edges)[1:3].T)
    sides.flags.writeable = False
    return sides


def pyramid_wrenches(
    points: FloatArray, inward: FloatArray, mu: float, length: float, sides: FloatArray
) -> FloatArray:
    """Wrenches (k n, 6) of the edges of friction pyramids, torques over ``length``.

    Args:
        points: (n, 3), m.
        inward: Unit normals (n, 3).
        mu: Friction (-).
        length: m.
        sides: Tangential force (k, 2) of each edge at a friction of 1.
    """
    least = np.argmin(np.abs(inward), axis=1)
    first = cross(inward, np.eye(3)[least])
    first /= np.sqrt((first * first).sum(axis=1, keepdims=True))
    second = cross(inward, first)
    one, two = (side[:, None, None] for side in sides.T)
    force = inward + mu * (one * first + two * second)
    wrenches = np.concatenate([force, cross(points, force) / length], axis=2)
    return np.asarray(wrenches.reshape(-1, 6))


def first_apart(directions: FloatArray, count: int) -> list[int]:
    """The first up to ``count`` of unit directions (k, 6) that are at least 20 degrees apart."""
    chosen: list[int] = []
    far = np.ones(len(directions), dtype=bool)
    while len(chosen) < count and far.any():
        chosen.append(int(far.argmax()))
        far &= directions @ directions[chosen[-1]] < APART
        far[chosen[-1]] = False
    return chosen
