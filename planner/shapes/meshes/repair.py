"""Repair of the edges of triangles, so that each is of two that run through it oppositely.

In this order: triangles without extent go, and so do repeated ones; nearly equal vertices on open
edges become one; flaps that hang on an edge of three triangles go; neighbours are wound alike;
surfaces that touch along an edge are cut apart there; holes are closed. ``right_side_out`` turns
whole bodies. These are the defects that scanners, exporters and decimation leave; crossings are
the matter of ``patches``.

By hand: ``trimesh.repair`` closes holes and turns faces only with networkx, which nothing else here
needs, and does not say what it changed; it does not cut surfaces apart.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner.shapes.meshes.holes import close_holes
from planner.shapes.meshes.soundness import (
    bodies_of,
    body_volumes,
    directed_edges,
    joined,
    paired_edges,
    surroundings,
    undirected_edges,
)
from planner.spatial import FloatArray, IntArray

MERGE = 1e-5
"""Vertices on open edges nearer than this fraction of the longest extent become one."""

Triangles = tuple[FloatArray, IntArray]


def with_paired_edges(
    vertices: FloatArray, faces: IntArray, widest: float, done: list[str]
) -> Triangles:
    """Vertices (n, 3), m, and faces (m, 3) with as few faulty edges as can be had.

    Args:
        vertices: (n, 3), m.
        faces: (m, 3).
        widest: Largest extent (m) of a hole that is closed.
        done: Gets the repairs, in words.
    """
    if paired_edges(faces) is not None:
        return vertices, faces
    faces = _once(faces, done)
    if len(faces) == 0:
        return vertices, faces
    vertices, faces = _merged(vertices, faces, done)
    faces = _without_flaps(faces, done)
    faces = _alike(faces, done)
    vertices, faces = _cut_apart(vertices, faces, done)
    vertices, faces, widths = close_holes(vertices, faces, widest)
    if widths:
        done.append(f"{len(widths)} hole(s) closed, up to {1e3 * max(widths):.2g} mm wide")
    return vertices, faces


def _once(faces: IntArray, done: list[str]) -> IntArray:
    """No triangle with two equal corners, none twice; two wound oppositely enclose nothing and go.

    Where two solids share a face, what goes is the wall between them.
    """
    extended = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    left: IntArray = faces[extended]
    if len(left) == 0:
        return left
    after = (np.argmin(left, axis=1)[:, None] + np.array([1, 2])) % 3
    second, third = np.take_along_axis(left, after, axis=1).T
    _, first, of_face = np.unique(
        np.sort(left, axis=1), axis=0, return_index=True, return_inverse=True
    )
    sense = np.bincount(of_face.ravel(), np.where(second < third, 1.0, -1.0))
    left = np.take(left, np.sort(first[sense != 0]), axis=0)
    if len(left) < len(faces):
        done.append(f"{len(faces) - len(left)} repeated or empty triangle(s) removed")
    return left


def _merged(vertices: FloatArray, faces: IntArray, done: list[str]) -> Triangles:
    """One vertex for all on open edges that are nearly equal."""
    from scipy.spatial import cKDTree  # here, since SciPy loads slowly

    keys = undirected_edges(faces)
    _, of_edge, counts = np.unique(keys, return_inverse=True, return_counts=True)
    tail, head = directed_edges(faces)
    is_open = counts[of_edge] == 1
    rim = np.unique(np.r_[tail[is_open], head[is_open]])
    if len(rim) == 0:
        return vertices, faces
    grain = MERGE * float(np.ptp(vertices, axis=0).max())
    near = cKDTree(vertices[rim]).query_pairs(grain, output_type="ndarray")
    if len(near) == 0:
        return vertices, faces
    size = len(rim)
    group = joined(near[:, 0], near[:, 1], size)
    _, first = np.unique(group, return_index=True)
    target = np.arange(len(vertices))
    target[rim] = rim[first[group]]
    done.append(f"{size - len(first)} repeated vertices merged")
    return vertices, _once(target[faces], done)


def _without_flaps(faces: IntArray, done: list[str]) -> IntArray:
    """No sheet that ends in the open and hangs on a surface only by edges of three or more."""
    keys = undirected_edges(faces)
    _, of_edge, counts = np.unique(keys, return_inverse=True, return_counts=True)
    shared = counts[of_edge].reshape(-1, 3)
    if not (shared == 1).any() or not (shared > 2).any():
        return faces
    pairs = np.argsort(of_edge, kind="stable")[np.repeat(counts == 2, counts)].reshape(-1, 2) // 3
    size = len(faces)
    sheet = joined(pairs[:, 0], pairs[:, 1], size)
    ends = np.bincount(sheet, (shared == 1).any(axis=1)) > 0
    hangs = np.bincount(sheet, (shared > 2).any(axis=1)) > 0
    flap = (ends & hangs)[sheet]
    if flap.all() or not flap.any():
        return faces
    done.append(f"{int(flap.sum())} triangle(s) of flaps removed")
    rest: IntArray = faces[~flap]
    return rest


def _alike(faces: IntArray, done: list[str]) -> IntArray:
    """Turn triangles until neighbours run through their common edge in opposite directions.

    Each triangle is a node twice, as it is and turned, linked with its neighbours' that agree: the
    component of one triangle as it is tells which of its body are to be turned.
    """
    keys = undirected_edges(faces)
    tail, _ = directed_edges(faces)
    order = np.argsort(keys, kind="stable")
    counts = np.unique(keys, return_counts=True)[1]
    pairs = order[np.repeat(counts == 2, counts)].reshape(-1, 2)
    one, other = pairs[:, 0] // 3, pairs[:, 1] // 3
    unlike = tail[pairs[:, 0]] == tail[pairs[:, 1]]
    if not unlike.any():
        return faces
    size = len(faces)
    row = np.r_[one, one + size]
    column = np.r_[np.where(unlike, other + size, other), np.where(unlike, other, other + size)]
    label = joined(row, column, 2 * size)
    body = bodies_of(faces)
    _, first = np.unique(body, return_index=True)
    kept = label[first][np.unique(body, return_inverse=True)[1]]
    turned = (label[:size] != kept) & (label[size:] == kept)
    # the smaller part of a body is the wrongly wound one; right_side_out judges whole bodies
    share = np.bincount(body, weights=turned) / np.maximum(np.bincount(body), 1)
    turned ^= (share > 0.5)[body] & (label[:size] != label[size:])
    if turned.any():
        done.append(f"{int(turned.sum())} triangle(s) turned to agree with their neighbours")
    out: IntArray = faces.copy()
    out[turned] = out[turned][:, ::-1]
    return out


def _cut_apart(vertices: FloatArray, faces: IntArray, done: list[str]) -> Triangles:
    """Surfaces that touch along an edge, or in a corner, get vertices of their own there.

    Around an edge of more than two triangles, one that is run through forward goes with the next
    backward one on its inner side: solids that touch are cut, not fused.
    """
    keys = undirected_edges(faces)
    _, of_edge, counts = np.unique(keys, return_inverse=True, return_counts=True)
    order = np.argsort(of_edge, kind="stable")
    starts = np.cumsum(counts) - counts
    pairs = [order[np.repeat(counts == 2, counts)].reshape(-1, 2)]
    crowded = np.flatnonzero(counts > 2)
    if len(crowded):
        done.append(f"{len(crowded)} edge(s) of more than two triangles cut apart")
    for edge in crowded.tolist():
        group = order[starts[edge] : starts[edge] + counts[edge]]
        pairs.append(_wedges(vertices, faces, group))
    along = np.concatenate(pairs)
    # corners are one vertex where their triangles are joined along an edge
    a, b = along[:, 0], along[:, 1]
    tail, _ = directed_edges(faces)
    after = 3 * (np.arange(len(tail)) // 3) + (np.arange(len(tail)) + 1) % 3
    same = tail[a] == tail[b]
    row = np.r_[a, after[a]]
    column = np.r_[np.where(same, b, after[b]), np.where(same, after[b], b)]
    corner = joined(row, column, len(tail))
    _, first, corner = np.unique(corner, return_index=True, return_inverse=True)
    return vertices[tail[first]], corner.reshape(-1, 3)


def _wedges(vertices: FloatArray, faces: IntArray, group: IntArray) -> IntArray:
    """Pairs (k, 2) of the directed edges ``group``, all of one edge, that bound matter between."""
    tail, head = directed_edges(faces)
    low, high = sorted((int(tail[group[0]]), int(head[group[0]])))
    axis = vertices[high] - vertices[low]
    apex = vertices[faces[group // 3, (group + 2) % 3]] - vertices[low]
    side = apex - np.outer(apex @ axis / max(float(axis @ axis), 1e-300), axis)
    x = side[0] / max(float(np.linalg.norm(side[0])), 1e-300)
    y = np.cross(axis / max(float(np.linalg.norm(axis)), 1e-300), x)
    angle = np.arctan2(side @ y, side @ x)
    forward: NDArray[np.bool_] = tail[group] == low
    free = set(np.flatnonzero(~forward).tolist())
    out = []
    for k in np.flatnonzero(forward).tolist():
        if not free:
            break
        # the inside of a triangle that is run through forward is on the side of lower angles
        nearest = min(free, key=lambda j: (float((angle[k] - angle[j]) % (2 * np.pi)), j))
        free.remove(nearest)
        out.append((group[k], group[nearest]))
    return np.array(out, dtype=np.int64).reshape(-1, 2)


def right_side_out(vertices: FloatArray, faces: IntArray, done: list[str]) -> IntArray:
    """Turn bodies inside out whose normals point inwards, unless they are cavities in another."""
    body = bodies_of(faces)
    volumes = body_volumes(vertices, faces, body)
    if (volumes > 0).all():
        return faces
    corners = vertices[faces]
    # whether a body lies in others does not depend on how they are wound
    turned = volumes[body] < 0
    corners[turned] = corners[turned][:, ::-1]
    around = surroundings(corners, body, len(volumes))
    wrong = (volumes < 0) & (around == 0)
    if wrong.any():
        done.append(f"{int(wrong.sum())} part(s) whose normals pointed inwards turned")
    out = faces.copy()
    out[wrong[body]] = out[wrong[body]][:, ::-1]
    return out
