"""Kernels of ``planner.proximity.mesh_gaps``: distances of convex bodies from a tree of triangles.

A ball around triangles is no nearer to a body than its centre to the body's core, less both radii.
Of the core, the box around it is taken, and the half space that it was in when the nearest triangle
so far was found. What cannot be nearer than that is left out, the nearer of two nodes is looked at
first.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from planner.numerics.kernels import kernel, loops_of_kernels
from planner.proximity.gap_loops import gap_to_triangle
from planner.spatial import FloatArray, IntArray

__all__ = ["COLUMNS", "gaps_to_triangles"]

COLUMNS = 7
"""Distance, nearest points of core and mesh."""

SAME = 1e-9
"""How much (m) is added to a known distance so that it is found again."""


def _gaps_plain(
    kinds: IntArray,
    sizes: FloatArray,
    points: FloatArray,
    first: IntArray,
    which: IntArray,
    turns: FloatArray,
    shifts: FloatArray,
    corners: FloatArray,
    balls: FloatArray,
    nodes: FloatArray,
    leaves: IntArray,
    limit: float,
    floor: float,
    known: FloatArray,
) -> FloatArray:
    """``gaps_to_triangles`` in NumPy: all triangles, in the order of their bounds."""
    out = np.zeros((len(which), COLUMNS))
    out[:, 0] = np.inf
    work, gap = np.zeros((14, 4)), _loops(gap_to_triangle)
    for row, body, turn, shift in zip(out, which, turns, shifts, strict=True):
        core, radius = sizes[body, :3], sizes[body, 3]
        gaps = np.maximum(np.abs((balls[:, :3] - shift) @ turn) - core, 0.0)
        bounds = np.linalg.norm(gaps, axis=1) - balls[:, 3]
        best = limit + radius
        for f in np.argsort(bounds, kind="stable"):
            if bounds[f] >= best or row[0] <= 0.0 < core.max():
                break
            local = (corners[f] - shift) @ turn
            found = gap(kinds[body], core, points, first[body], first[body + 1], local, best, work)
            if found < best:
                best = found
                row[0] = best - radius
                row[1:4], row[4:7] = turn @ work[8, :3] + shift, turn @ work[9, :3] + shift
    if len(known) > 0:
        least = max(np.sort(np.concatenate([known, out[:, 0]]))[len(known) - 1], floor)
        out[out[:, 0] > least, 0] = np.inf
    return out


def _loops(marked: Any) -> Any:
    return marked.loops


@kernel(_gaps_plain)
def gaps_to_triangles(
    kinds: IntArray,
    sizes: FloatArray,
    points: FloatArray,
    first: IntArray,
    which: IntArray,
    turns: FloatArray,
    shifts: FloatArray,
    corners: FloatArray,
    balls: FloatArray,
    nodes: FloatArray,
    leaves: IntArray,
    limit: float,
    floor: float,
    known: FloatArray,
) -> FloatArray:
    """Distances of convex bodies from triangles, as far as they are below a limit.

    Where body and triangles meet, the distance is not above 0: right of a ball, else of no meaning.

    Args:
        kinds: Of n bodies, see ``ConvexBodies``.
        sizes: Half extents and radius (n, 4), m.
        points: Points of hulls (p, 3), m.
        first: Where those of each body begin (n + 1,).
        which: Bodies that are asked for (k,).
        turns: Rotations of their middles in the mesh's frame (k, 3, 3).
        shifts: Positions of their middles there (k, 3), m.
        corners: Of the triangles (m, 3, 3), see ``BallTree``.
        balls: Around them (m, 4), m.
        nodes: Around those of each node, (nodes, 4), m.
        leaves: Where the triangles of each leaf begin (leaves + 1,).
        limit: Distances from which on it is not of interest how large they are, m.
        floor: Distances above this (m) are not of interest if they are not of the smallest.
        known: Distances (count,) that are known, ascending, m: only the ``count`` smallest of them
            and of what is found are of interest. All are if there are none.

    Returns:
        (k, 7): distance, m, infinite where it is not of interest; nearest points of core and mesh
        in the mesh's frame, m.
    """
    count, n = len(known), len(which)
    out = np.zeros((n, COLUMNS))
    out[:, 0] = np.inf
    work, plane, local, stack, bounds = (
        np.zeros((14, 4)),
        np.zeros(4),
        np.empty((3, 3)),
        np.empty(64, dtype=np.int64),
        np.empty(64),
    )
    values = np.full(count + n, np.inf)
    values[:count] = known
    order = np.arange(n)
    if count > 0 and n > 1:
        for i in range(n):
            body = which[i]
            plane[:] = 0.0
            at = _likely_leaf(sizes[body], turns[i], shifts[i], plane, nodes)
            values[count + i] = _gap_to_leaf(
                kinds[body],
                sizes[body],
                points,
                first[body],
                first[body + 1],
                turns[i],
                shifts[i],
                corners,
                balls,
                leaves[at],
                leaves[at + 1],
                limit,
                plane,
                local,
                work,
                out[i],
            )
        for i in range(1, n):  # by insertion
            j = i
            while j > 0 and values[count + order[j]] < values[count + order[j - 1]]:
                order[j], order[j - 1] = order[j - 1], order[j]
                j -= 1
    for place in range(n):
        i = int(order[place])
        body, below = which[i], limit
        if count > 0:
            below = max(_smallest(values, count), floor)
            if values[count + i] <= below:
                below = values[count + i] + SAME
            below = min(below, limit)
        out[i, 0], plane[:] = np.inf, 0.0
        _gap_to_tree(
            kinds[body],
            sizes[body],
            points,
            first[body],
            first[body + 1],
            turns[i],
            shifts[i],
            corners,
            balls,
            nodes,
            leaves,
            below,
            plane,
            local,
            work,
            stack,
            bounds,
            out[i],
        )
        values[count + i] = out[i, 0]
    if count > 0:
        below = max(_smallest(values, count), floor)
        for i in range(n):
            if out[i, 0] > below:
                out[i, 0] = np.inf
    return out


@loops_of_kernels
def _smallest(values: FloatArray, count: int) -> float:
    """The ``count``-th smallest value."""
    least = np.full(count, np.inf)
    for value in values:
        if value < least[count - 1]:
            j = count - 1
            while j > 0 and least[j - 1] > value:
                least[j] = least[j - 1]
                j -= 1
            least[j] = value
    return float(least[count - 1])


@loops_of_kernels
def _bound(
    size: FloatArray, turn: FloatArray, shift: FloatArray, plane: FloatArray, ball: FloatArray
) -> float:
    """Lower bound (m) of the distance of a ball from a body whose core is below a plane (4,)."""
    x, y, z = ball[0] - shift[0], ball[1] - shift[1], ball[2] - shift[2]
    above = plane[0] * x + plane[1] * y + plane[2] * z - plane[3]
    square = 0.0
    for k in range(3):
        apart = abs(turn[0, k] * x + turn[1, k] * y + turn[2, k] * z) - size[k]
        if apart > 0.0:
            square += apart * apart
    return float(max(math.sqrt(square), above) - size[3] - ball[3])


@loops_of_kernels
def _likely_leaf(
    size: FloatArray, turn: FloatArray, shift: FloatArray, plane: FloatArray, nodes: FloatArray
) -> int:
    """The leaf that one comes to by the nearer child of each node."""
    node, inner = 0, len(nodes) // 2
    while node < inner:
        left, right = nodes[2 * node + 1], nodes[2 * node + 2]
        nearer = _bound(size, turn, shift, plane, left) <= _bound(size, turn, shift, plane, right)
        node = 2 * node + 1 if nearer else 2 * node + 2
    return node - inner


@loops_of_kernels
def _gap_to_leaf(
    kind: int,
    size: FloatArray,
    points: FloatArray,
    begin: int,
    end: int,
    turn: FloatArray,
    shift: FloatArray,
    corners: FloatArray,
    balls: FloatArray,
    low: int,
    high: int,
    limit: float,
    plane: FloatArray,
    local: FloatArray,
    work: FloatArray,
    row: FloatArray,
) -> float:
    """The smallest distance (m) of triangles low to high, or the limit; in the row how it lies."""
    for f in range(low, high):
        if _bound(size, turn, shift, plane, balls[f]) >= limit:
            continue
        for c in range(3):
            x, y, z = (
                corners[f, c, 0] - shift[0],
                corners[f, c, 1] - shift[1],
                corners[f, c, 2] - shift[2],
            )
            for k in range(3):
                local[c, k] = turn[0, k] * x + turn[1, k] * y + turn[2, k] * z
        wanted = limit + size[3]
        found = gap_to_triangle(kind, size, points, begin, end, local, wanted, work)
        if found < wanted:
            limit = found - size[3]
            row[0] = limit
            plane[3] = 0.0
            for k in range(3):
                on_core = on_mesh = 0.0
                for c in range(3):
                    on_core += turn[k, c] * work[8, c]
                    on_mesh += turn[k, c] * work[9, c]
                row[1 + k], row[4 + k] = shift[k] + on_core, shift[k] + on_mesh
                plane[k] = (on_mesh - on_core) / found if found > 0.0 else 0.0
                plane[3] += plane[k] * on_core
    return limit


@loops_of_kernels
def _gap_to_tree(
    kind: int,
    size: FloatArray,
    points: FloatArray,
    begin: int,
    end: int,
    turn: FloatArray,
    shift: FloatArray,
    corners: FloatArray,
    balls: FloatArray,
    nodes: FloatArray,
    leaves: IntArray,
    limit: float,
    plane: FloatArray,
    local: FloatArray,
    work: FloatArray,
    stack: IntArray,
    bounds: FloatArray,
    row: FloatArray,
) -> None:
    """The same of all triangles; once something but a ball meets one, it is left at that."""
    inner = len(nodes) // 2
    ball = size[0] == 0.0 and size[1] == 0.0 and size[2] == 0.0
    stack[0], bounds[0], top = 0, -np.inf, 1
    while top > 0:
        top -= 1
        node = stack[top]
        if bounds[top] >= limit or (limit <= 0.0 and row[0] <= 0.0 and not ball):
            continue
        if node >= inner:
            limit = _gap_to_leaf(
                kind,
                size,
                points,
                begin,
                end,
                turn,
                shift,
                corners,
                balls,
                leaves[node - inner],
                leaves[node - inner + 1],
                limit,
                plane,
                local,
                work,
                row,
            )
            continue
        near, far = 2 * node + 1, 2 * node + 2
        to_near = _bound(size, turn, shift, plane, nodes[near])
        to_far = _bound(size, turn, shift, plane, nodes[far])
        if to_far < to_near:
            near, far, to_near, to_far = far, near, to_far, to_near
        if to_far < limit:
            stack[top], bounds[top] = far, to_far
            top += 1
        if to_near < limit:
            stack[top], bounds[top] = near, to_near
            top += 1
