"""Holes of a surface: their rims, and triangles that close them with the least area."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner.shapes.meshes.soundness import directed_edges
from planner.spatial import FloatArray, IntArray

LONGEST_RIM = 160
"""Corners of a rim, at most, that is closed by triangles of least area, which takes time with the
third power; a longer one is closed by a fan from its middle."""


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
        while following.get(start):
            loop, at = [start], {start: 0}
            while following.get(loop[-1]):
                step = following[loop[-1]].pop()
                if step in at:
                    ring = loop[at[step] :]
                    loops.append(np.array(ring))
                    for vertex in ring[1:]:
                        del at[vertex]
                    del loop[at[step] + 1 :]
                    if len(loop) == 1 and not following.get(loop[0]):
                        break
                    continue
                at[step] = len(loop)
                loop.append(step)
    return [loop for loop in loops if len(loop) >= 3]


def hole_widths(vertices: FloatArray, faces: IntArray) -> list[float]:
    """Extents (m) of the holes, in the order of ``rims``: longest side of the box around each."""
    return [float(np.ptp(vertices[ring], axis=0).max()) for ring in rims(faces)]


def close_holes(
    vertices: FloatArray, faces: IntArray, widest: float
) -> tuple[FloatArray, IntArray, list[float]]:
    """Vertices, faces, and the widths (m) of the holes that were closed.

    Args:
        vertices: (n, 3), m.
        faces: (m, 3), consistently wound.
        widest: Largest extent of a hole that is closed, m.
    """
    points, parts, widths = [vertices], [faces], []
    count = len(vertices)
    for ring, width in zip(rims(faces), hole_widths(vertices, faces), strict=True):
        if width > widest:
            continue
        widths.append(width)
        filling = None
        if len(ring) <= LONGEST_RIM:
            filling = _least_area(vertices[ring], _joined(ring, faces))
        if filling is not None:
            parts.append(ring[filling])
            continue
        points.append(vertices[ring].mean(axis=0)[None])
        parts.append(np.column_stack([ring, np.roll(ring, -1), np.full(len(ring), count)]))
        count += 1
    return np.concatenate(points), np.concatenate(parts), widths


def _joined(ring: IntArray, faces: IntArray) -> NDArray[np.bool_]:
    """Which vertices of a rim (n, n) are the ends of an edge already."""
    place = np.full(int(faces.max()) + 1, -1)
    place[ring] = np.arange(len(ring))
    tail, head = directed_edges(faces)
    a, b = place[tail], place[head]
    both = (a >= 0) & (b >= 0)
    out = np.zeros((len(ring), len(ring)), dtype=bool)
    out[a[both], b[both]] = out[b[both], a[both]] = True
    return out


def _least_area(ring: FloatArray, joined: NDArray[np.bool_]) -> IntArray | None:
    """Triangles (n - 2, 3) of a closed polygon (n, 3 coordinates) with the least area together.

    None if none does without a diagonal between vertices that an edge joins already. Dynamic
    programming (Barequet and Sharir, "Filling gaps in the boundary of a polyhedron", 1995).
    """
    n = len(ring)
    cost, split = np.zeros((n, n)), np.zeros((n, n), dtype=np.int64)
    for gap in range(2, n):
        for i in range(n - gap):
            k, between = i + gap, np.arange(i + 1, i + gap)
            normal = np.cross(ring[between] - ring[i], ring[k] - ring[i])
            total = cost[i, between] + cost[between, k] + np.linalg.norm(normal, axis=1)
            best = int(np.argmin(total))
            taken = joined[i, k] and gap < n - 1
            cost[i, k], split[i, k] = np.inf if taken else total[best], between[best]
    if not np.isfinite(cost[0, n - 1]):
        return None
    out, stack = [], [(0, n - 1)]
    while stack:
        i, k = stack.pop()
        if k - i >= 2:
            middle = int(split[i, k])
            out.append((i, middle, k))
            stack += [(i, middle), (middle, k)]
    return np.array(out, dtype=np.int64)
