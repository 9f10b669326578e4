"""Repair of triangles that are nearly the surface of a solid, with a list of the repairs.

In this order: equal vertices become one, triangles without extent and repeated ones go,
neighbours are wound alike, small holes are closed with a fan, and bodies are turned right side out.
These are the defects that scanners and exporters leave. Crossings are not repaired.

By hand: ``trimesh.repair`` closes holes and turns faces only with networkx, which nothing else here
needs, and does not say what it changed.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from planner.shapes.meshes.soundness import bodies_of, body_volumes, directed_edges
from planner.shapes.meshes.triangles import winding_number
from planner.spatial import FloatArray, IntArray

__all__ = ["repaired"]

MERGE = 1e-5
"""Vertices nearer than this fraction of the object's longest extent become one."""

WIDEST_HOLE = 0.3
"""A hole is closed if its extent is at most this fraction of the object's: a wider one is no
defect, but the shape itself (an open shell)."""


def repaired(vertices: FloatArray, faces: IntArray) -> tuple[FloatArray, IntArray, tuple[str, ...]]:
    """Vertices (n, 3), m, faces (m, 3), and the repairs, in words."""
    done: list[str] = []
    vertices, faces = _merged(vertices, faces, done)
    faces = _alike(faces, done)
    vertices, faces = _closed(vertices, faces, done)
    faces = _outward(vertices, faces, done)
    return vertices, faces, tuple(done)


def _merged(vertices: FloatArray, faces: IntArray, done: list[str]) -> tuple[FloatArray, IntArray]:
    """One vertex for all that are nearly equal; no triangle with two equal corners or twice."""
    grain = MERGE * float(np.ptp(vertices, axis=0).max())
    _, first, of_vertex = np.unique(
        np.round(vertices / grain), axis=0, return_index=True, return_inverse=True
    )
    if len(first) < len(vertices):
        done.append(f"merged {len(vertices) - len(first)} repeated vertices")
    faces = of_vertex.reshape(-1)[faces]
    extended = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    if not extended.all():
        done.append(f"removed {int((~extended).sum())} triangles with two equal corners")
    faces = faces[extended]
    _, once = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    if len(once) < len(faces):
        done.append(f"removed {len(faces) - len(once)} repeated triangles")
    return vertices[first], faces[np.sort(once)]


def _alike(faces: IntArray, done: list[str]) -> IntArray:
    """Turn triangles until neighbours run through their common edge in opposite directions."""
    tail, head = directed_edges(faces)
    of_edge: dict[tuple[int, int], list[tuple[int, bool]]] = {}
    for k, (a, b) in enumerate(zip(tail.tolist(), head.tolist(), strict=True)):
        of_edge.setdefault((min(a, b), max(a, b)), []).append((k // 3, a < b))
    links: list[list[tuple[int, bool]]] = [[] for _ in faces]
    for sides in of_edge.values():
        if len(sides) == 2:
            (one, forward), (other, also) = sides
            links[one].append((other, forward == also))
            links[other].append((one, forward == also))
    turned = np.zeros(len(faces), dtype=bool)
    seen = np.zeros(len(faces), dtype=bool)
    for start in range(len(faces)):
        queue = deque([] if seen[start] else [start])
        while queue:
            face = queue.popleft()
            if seen[face]:
                continue
            seen[face] = True
            for other, unlike in links[face]:
                if not seen[other]:
                    turned[other] = turned[face] ^ unlike
                    queue.append(other)
    # the smaller part of a body is the wrongly wound one; _outward judges whole bodies
    body = bodies_of(faces)
    share = np.bincount(body, weights=turned) / np.bincount(body)
    turned ^= (share > 0.5)[body]
    if turned.any():
        done.append(f"turned {int(turned.sum())} triangles to agree with their neighbours")
    out = faces.copy()
    out[turned] = out[turned][:, ::-1]
    return out


def _closed(vertices: FloatArray, faces: IntArray, done: list[str]) -> tuple[FloatArray, IntArray]:
    """Close each small hole by a fan from its middle."""
    tail, head = directed_edges(faces)
    n = len(vertices)
    forward = tail * n + head
    rim = ~np.isin(forward, head * n + tail)
    following: dict[int, list[int]] = {}
    for a, b in zip(head[rim].tolist(), tail[rim].tolist(), strict=True):
        following.setdefault(a, []).append(b)
    widest = WIDEST_HOLE * float(np.ptp(vertices, axis=0).max())
    points, fans = [vertices], [faces]
    for start in list(following):
        while following.get(start):
            loop = [start]
            while following.get(loop[-1]):
                loop.append(following[loop[-1]].pop())
                if loop[-1] == start:
                    break
            ring = np.array(loop[:-1])
            if loop[-1] != start or len(ring) < 3:
                continue
            if float(np.ptp(vertices[ring], axis=0).max()) > widest:
                continue
            middle = sum(len(p) for p in points)
            if len(ring) == 3:
                fans.append(ring[None])
            else:
                points.append(vertices[ring].mean(axis=0)[None])
                fans.append(np.column_stack([ring, np.roll(ring, -1), np.full(len(ring), middle)]))
            done.append(f"closed a hole of {len(ring)} edges")
    return np.concatenate(points), np.concatenate(fans)


def _outward(vertices: FloatArray, faces: IntArray, done: list[str]) -> IntArray:
    """Turn bodies inside out whose normals point inwards, unless they are cavities in another."""
    body = bodies_of(faces)
    volumes = body_volumes(vertices, faces, body)
    out, corners = faces.copy(), vertices[faces]
    for b, volume in enumerate(volumes):
        others = body != b
        probe = corners[np.flatnonzero(body == b)[:1]].mean(axis=1)
        around = abs(winding_number(probe, corners[others])[0]) if others.any() else 0.0
        if volume < 0 and around < 0.5:
            out[body == b] = out[body == b][:, ::-1]
            done.append("turned a body whose normals pointed inwards")
    return out
