"""Edges and bodies of triangles: which triangles meet at each edge, and which hang together."""

from __future__ import annotations

import numpy as np

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
