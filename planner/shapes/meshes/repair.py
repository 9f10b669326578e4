"""Edges of triangles repaired, so that each is of two that run through it oppositely; holes closed.

In this order: triangles without extent go, and so do repeated ones; nearly equal vertices on open
edges become one; flaps that hang on an edge of three triangles go; neighbours are wound alike;
holes are closed; surfaces that touch along an edge are cut apart there. These are the defects that
scanners, exporters and decimation leave; crossings are the matter of ``mending``.

By hand but for the last two, which manifold3d does: it refuses open edges, and ``trimesh.repair``
closes holes and turns faces only with networkx, which nothing else here needs, and does not say
what it changed.
"""

from __future__ import annotations

from typing import Any

import numpy as np

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

Surface = tuple[FloatArray, IntArray]
"""Vertices (n, 3), m, and faces (m, 3)."""

WIDEST_HOLE = 0.3
"""A hole is closed on request if its extent is at most this fraction of the object's: a wider one
is no defect, but the shape itself (an open shell)."""

MERGE = 1e-5
"""Vertices on open edges nearer than this fraction of the longest extent become one."""

SAME = 1e-12
"""Distance (m) below which the middles of two triangles are one: rounding."""


def manifold_of(vertices: FloatArray, faces: IntArray) -> Any:
    """A surface as a ``manifold3d.Manifold``; empty if its edges are not paired."""
    import manifold3d  # here, since only faulty meshes need it

    used, own = np.unique(faces, return_inverse=True)
    mesh = manifold3d.Mesh64(
        np.ascontiguousarray(vertices[used]),
        np.ascontiguousarray(own.reshape(-1, 3), dtype=np.uint64),
    )
    return manifold3d.Manifold(mesh)


def surface_of(solid: Any) -> Surface:
    """Vertices and faces of a ``manifold3d.Manifold``."""
    mesh = solid.to_mesh64()
    points = np.array(mesh.vert_properties, dtype=np.float64)[:, :3]
    return points, np.array(mesh.tri_verts, dtype=np.int64)


def with_paired_edges(vertices: FloatArray, faces: IntArray, done: list[str]) -> Surface:
    """Vertices (n, 3), m, and faces (m, 3) with as few faulty edges as can be had.

    Args:
        vertices: (n, 3), m.
        faces: (m, 3).
        done: Gets the repairs, in words.
    """
    if paired_edges(faces) is not None:
        return vertices, faces
    widest = WIDEST_HOLE * float(np.ptp(vertices, axis=0).max())
    faces = _once(faces, done)
    if len(faces) == 0:
        return vertices, faces
    faces = _once(_merged(vertices, faces, done), done)
    faces = _alike(_without_flaps(faces, done), done)
    vertices, faces, widths = with_closed_holes(vertices, faces, widest)
    if widths:
        done.append(f"{len(widths)} hole(s) closed, up to {1e3 * max(widths):.2g} mm wide")
    if paired_edges(faces) is None:
        apart = manifold_of(vertices, faces)  # cuts apart what touches along an edge
        if not apart.is_empty():
            _, counts = np.unique(undirected_edges(faces), return_counts=True)
            crowded = int((counts > 2).sum())
            done.append(f"{crowded} edge(s) of more than two triangles cut apart")
            vertices, faces = surface_of(apart)
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


def _merged(vertices: FloatArray, faces: IntArray, done: list[str]) -> IntArray:
    """One vertex for all on open edges that are nearly equal."""
    from scipy.spatial import cKDTree  # here, since SciPy loads slowly

    _, of_edge, counts = np.unique(undirected_edges(faces), return_inverse=True, return_counts=True)
    rim = np.unique(np.concatenate(directed_edges(faces))[np.tile(counts[of_edge] == 1, 2)])
    grain = MERGE * float(np.ptp(vertices, axis=0).max())
    near = cKDTree(vertices[rim]).query_pairs(grain, output_type="ndarray") if len(rim) else rim
    if len(near) == 0:
        return faces
    group = joined(near[:, 0], near[:, 1], len(rim))
    _, first = np.unique(group, return_index=True)
    target = np.arange(len(vertices))
    target[rim] = rim[first[group]]
    done.append(f"{len(rim) - len(first)} repeated vertices merged")
    return np.asarray(target[faces])


def _without_flaps(faces: IntArray, done: list[str]) -> IntArray:
    """No sheet that ends in the open and hangs on a surface only by edges of three or more."""
    keys = undirected_edges(faces)
    _, of_edge, counts = np.unique(keys, return_inverse=True, return_counts=True)
    shared = counts[of_edge].reshape(-1, 3)
    pairs = np.argsort(of_edge, kind="stable")[np.repeat(counts == 2, counts)].reshape(-1, 2) // 3
    sheet = joined(pairs[:, 0], pairs[:, 1], len(faces))
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


def rims(faces: IntArray) -> list[IntArray]:
    """The rims of all holes, each the vertices in the order in which a filling runs round.

    A rim that meets itself in a vertex is told as several loops.
    """
    tail, head = directed_edges(faces)
    n = int(faces.max()) + 1
    is_open = ~np.isin(tail * n + head, head * n + tail)
    following: dict[int, list[int]] = {}
    for a, b in zip(head[is_open].tolist(), tail[is_open].tolist(), strict=True):
        following.setdefault(a, []).append(b)
    loops = []
    for start in list(following):
        path = [start]
        while following.get(path[-1]):
            step = following[path[-1]].pop()
            if step in path:
                at = path.index(step)
                loops.append(np.array(path[at:]))
                del path[at + 1 :]
            else:
                path.append(step)
    return [loop for loop in loops if len(loop) >= 3]


def hole_width(vertices: FloatArray, ring: IntArray) -> float:
    """Extent (m) of a hole: the longest side of the box around its rim."""
    return float(np.ptp(vertices[ring], axis=0).max())


def with_closed_holes(
    vertices: FloatArray, faces: IntArray, widest: float
) -> tuple[FloatArray, IntArray, list[float]]:
    """Vertices, faces, and the widths (m) of the holes that were closed.

    A rim is filled by manifold3d, seen along its mean normal.

    Args:
        vertices: (n, 3), m.
        faces: (m, 3), consistently wound.
        widest: Largest extent of a hole that is closed, m.
    """
    import manifold3d

    parts, widths = [faces], []
    for ring in rims(faces):
        width = hole_width(vertices, ring)
        if width > widest:
            continue
        widths.append(width)
        out = vertices[ring] - vertices[ring].mean(axis=0)
        normal = np.cross(out, np.roll(out, -1, axis=0)).sum(axis=0)
        first = np.cross(normal, np.eye(3)[int(np.argmin(np.abs(normal)))])
        across = np.column_stack([first, np.cross(normal, first)])
        flat = out @ (across / np.maximum(np.linalg.norm(across, axis=0), SAME))
        filling = manifold3d.triangulate([np.ascontiguousarray(flat)])
        parts.append(ring[np.asarray(filling, dtype=np.int64).reshape(-1, 3)])
    return vertices, np.concatenate(parts), widths
