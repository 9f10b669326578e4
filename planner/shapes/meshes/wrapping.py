"""The surface around everything that triangles enclose, made anew on a grid.

Rays along the grid's lines meet the triangles exactly; what they enter more often than they leave
is inside. Each cell that the boundary passes gets one vertex, where the planes of the triangles
that its edges meet come closest together, which keeps edges sharp (dual contouring: Ju, Losasso,
Schaefer and Warren, "Dual contouring of Hermite data", 2002).

By hand, because manifold3d's level sets need a distance, which crossing triangles do not have, and
scikit-image's marching cubes round every edge off.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner.spatial import FloatArray, IntArray

PINCH = 0.02
"""Weight of the middle of a vertex's points beside that of their planes, which alone leave a vertex
on a flat face loose."""

OFFSET = np.array([0.3819, 0.5257, 0.6180])
"""Where the grid begins, in cells: off the round numbers on which designers put faces."""


def wrapped(vertices: FloatArray, faces: IntArray, cells: int) -> tuple[FloatArray, IntArray]:
    """Vertices (n, 3), m, and faces (m, 3) of the boundary of what is enclosed, wound outwards.

    Details smaller than a cell are lost; the caller measures how far the surface moved.

    Args:
        vertices: (n, 3), m.
        faces: (m, 3), of closed bodies, wound outwards but for cavities.
        cells: Along the longest extent.
    """
    low = vertices.min(axis=0)
    step = float(np.ptp(vertices, axis=0).max()) / cells
    origin = low - (1 + OFFSET) * step
    shape = np.ceil(np.ptp(vertices, axis=0) / step).astype(np.int64) + 4
    corners = (vertices[faces] - origin) / step
    rays = [_rays(corners, axis, shape) for axis in range(3)]
    inside = _inside(rays[2], shape)
    weight, total, matrix, vector = _accumulated(rays, inside, shape)
    cell = np.flatnonzero(weight)
    mean = total[cell] / weight[cell, None]
    pull = vector[cell] - np.einsum("nij,nj->ni", matrix[cell], mean)
    shift = np.linalg.solve(matrix[cell] + PINCH * np.eye(3), pull[:, :, None])[:, :, 0]
    corner = np.column_stack(np.unravel_index(cell, tuple(shape)))
    points = np.clip(mean + shift, corner, corner + 1)
    number = np.full(int(np.prod(shape)), -1)
    number[cell] = np.arange(len(cell))
    return points * step + origin, number[_triangles(inside, shape)]


Rays = tuple[IntArray, FloatArray, FloatArray]
"""Grid lines' numbers (k,), depths (k,) in cells, and unit normals (k, 3) where they meet."""


def _rays(corners: FloatArray, axis: int, shape: IntArray) -> Rays:
    """Where the grid's lines along an axis meet triangles (m, 3 corners, 3), in cells."""
    u, v = (axis + 1) % 3, (axis + 2) % 3
    flat = corners[:, :, [u, v]]
    first = np.ceil(flat.min(axis=1)).astype(np.int64)
    count = np.maximum(np.floor(flat.max(axis=1)).astype(np.int64) - first + 1, 0)
    number = count.prod(axis=1)
    owner = np.repeat(np.arange(len(corners)), number)
    nth = np.arange(len(owner)) - np.repeat(np.cumsum(number) - number, number)
    at = first[owner] + np.column_stack([nth // count[owner, 1], nth % count[owner, 1]])
    a, b, c = (flat[owner, k] for k in range(3))
    parts = [_twice_area(p, q, at) for p, q in ((b, c), (c, a), (a, b))]
    whole = parts[0] + parts[1] + parts[2]
    hit = np.logical_and.reduce([p * np.sign(whole) > 0 for p in parts])
    owner, at, whole = owner[hit], at[hit], whole[hit]
    depth = sum(parts[k][hit] * corners[owner, k, axis] for k in range(3)) / whole
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    unit = normal / np.where(length > 0, length, 1.0)
    return at[:, 0] * shape[v] + at[:, 1], np.asarray(depth), unit[owner]


def _twice_area(p: FloatArray, q: FloatArray, r: FloatArray) -> FloatArray:
    """Twice the signed areas (n,) of triangles of points (n, 2)."""
    area: FloatArray = (q[:, 0] - p[:, 0]) * (r[:, 1] - p[:, 1])
    return area - (q[:, 1] - p[:, 1]) * (r[:, 0] - p[:, 0])


def _inside(rays: Rays, shape: IntArray) -> NDArray[np.bool_]:
    """Whether each node of the grid is enclosed, by the rays along the last axis."""
    line, depth, normal = rays
    steps = np.zeros((int(shape[0] * shape[1]), int(shape[2])))
    entered = -np.sign(normal[:, 2])
    np.add.at(steps, (line, np.floor(depth).astype(np.int64) + 1), entered)
    return np.cumsum(steps, axis=1).reshape(tuple(shape)) > 0.5


def _accumulated(
    rays: list[Rays], inside: NDArray[np.bool_], shape: IntArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Of each cell, over its edges that the boundary crosses: count, and sums of points and planes.

    Points p (n, 3), and n n' (n, 3, 3) and n (n . p) (n, 3) of the unit normals, in cells.
    """
    size = int(np.prod(shape))
    weight, total = np.zeros(size), np.zeros((size, 3))
    matrix, vector = np.zeros((size, 3, 3)), np.zeros((size, 3))
    for axis, (line, depth, normal) in enumerate(rays):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        node = np.empty((len(line), 3), dtype=np.int64)
        node[:, u], node[:, v] = np.divmod(line, shape[v])
        node[:, axis] = np.floor(depth)
        ahead = node + np.eye(3, dtype=np.int64)[axis]
        boundary = inside[tuple(node.T)] != inside[tuple(ahead.T)]
        node, plane = node[boundary], normal[boundary]
        point = node.astype(np.float64)
        point[:, axis] = depth[boundary]
        height = np.einsum("nd,nd->n", plane, point)
        for du in (0, 1):
            for dv in (0, 1):
                cell = node.copy()
                cell[:, u] -= du
                cell[:, v] -= dv
                index = np.ravel_multi_index(tuple(cell.T), tuple(shape))
                np.add.at(weight, index, 1.0)
                np.add.at(total, index, point)
                np.add.at(matrix, index, plane[:, :, None] * plane[:, None])
                np.add.at(vector, index, plane * height[:, None])
    return weight, total, matrix, vector


def _triangles(inside: NDArray[np.bool_], shape: IntArray) -> IntArray:
    """Cells (m, 3) whose vertices are the corners of each triangle, two for each crossed edge."""
    out = []
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        ahead = np.roll(inside, -1, axis=axis)
        node = np.column_stack(np.nonzero(inside != ahead))
        leaves = inside[tuple(node.T)]
        around = []
        for du, dv in ((1, 1), (0, 1), (0, 0), (1, 0)):
            cell = node.copy()
            cell[:, u] -= du
            cell[:, v] -= dv
            around.append(np.ravel_multi_index(tuple(cell.T), tuple(shape)))
        quads = np.column_stack(around)
        quads[~leaves] = quads[~leaves][:, ::-1]
        out += [quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]
    return np.concatenate(out)
