"""Balls that fill a link's geometry, and points that span it: in the geometry's own frame."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np

from planner.bridge import LinkGeometry
from planner.spatial import FloatArray

__all__ = ["fill", "span"]

SPACING = 2.0
"""Largest distance between neighbouring balls of a link, in radii."""

SLENDER = 1.4
"""A bar of a finger is filled with balls of the geometric mean of its half widths, at most this
many times the smaller: 1.4 reaches to the edges of a square bar. What a plain filling leaves out at
the edges, up to 0.4 half widths, is what fingers with square links collide with."""

THINNEST = 0.3
"""Balls in a hull are kept if their radius is at least this share of its smallest half extent."""

DIRECTIONS = 24
"""Directions in which the outermost points of a hull are taken to span it."""


def fill(geometry: LinkGeometry, *, slender: bool = False) -> tuple[FloatArray, FloatArray]:
    """Ball centres (n, 3), m, and radii (n,), m, all through a geometry.

    Balls are inside it, but for bars of fingers (``slender``), where they are a little too large.
    """
    a, b, c = (float(v) for v in geometry.size)
    if geometry.kind == "sphere":
        return np.zeros((1, 3)), np.array([a])
    if geometry.kind in ("capsule", "cylinder"):
        # a cylinder's end balls reach exactly to its flat ends
        z = _row(b if geometry.kind == "capsule" else max(b - a, 0.0), a)
        return np.column_stack([np.zeros_like(z), np.zeros_like(z), z]), np.full(len(z), a)
    if geometry.kind == "mesh":
        return _fill_hull(geometry.geometry)
    half = np.array([a, b, c])
    radius = float(half.min())
    if slender and geometry.kind == "box":
        radius = min(SLENDER * radius, float(np.sqrt(np.prod(np.sort(half)[:2]))))
    grid = _grid(half, radius)
    return grid, np.full(len(grid), radius)


def span(geometry: LinkGeometry) -> tuple[FloatArray, float]:
    """Points (n, 3), m, and a radius (m): the hull of balls of that radius there is the geometry.

    A little more than it for a cylinder, whose rim is a prism's; a little less for a round hull.
    """
    a, b, c = (float(v) for v in geometry.size)
    if geometry.kind == "sphere":
        return np.zeros((1, 3)), a
    if geometry.kind == "capsule":
        return np.array([[0.0, 0.0, -b], [0.0, 0.0, b]]), a
    if geometry.kind == "cylinder":
        return _prism(a, b), 0.0
    if geometry.kind == "mesh":
        vertices = np.array(geometry.geometry.points())
        outermost = np.unique(np.argmax(vertices @ _directions().T, axis=0))
        return vertices[outermost], 0.0
    return np.array(list(product(*([-h, h] for h in (a, b, c))))), 0.0


def _fill_hull(hull: Any) -> tuple[FloatArray, FloatArray]:
    """The largest balls of a convex polyhedron about the points of a grid."""
    vertices = np.array(hull.points())
    normals, offsets = np.array(hull.normals()), np.array(hull.offsets())
    lower, upper = vertices.min(axis=0), vertices.max(axis=0)
    half = (upper - lower) / 2
    grid = _grid(half, float(half.min())) + (lower + upper) / 2
    inner = vertices.mean(axis=0)
    # faces point out of the hull whatever sign their offsets have
    side = np.sign(normals @ inner + offsets)
    depth = (side * (grid @ normals.T + offsets)).min(axis=1)
    good = depth >= THINNEST * half.min()
    if not good.any():
        good = depth == depth.max()
    return grid[good], np.maximum(depth[good], 0.0)


def _grid(half: FloatArray, radius: float) -> FloatArray:
    rows = [_row(float(max(h - radius, 0.0)), radius) for h in half]
    return np.stack(np.meshgrid(*rows, indexing="ij"), axis=-1).reshape(-1, 3)


def _directions() -> FloatArray:
    """Unit vectors (``DIRECTIONS``, 3) spread evenly over the sphere (Fibonacci spiral)."""
    k = np.arange(DIRECTIONS) + 0.5
    z = 1 - 2 * k / DIRECTIONS
    turn = np.pi * (1 + 5**0.5) * k
    ring = np.sqrt(1 - z**2)
    return np.column_stack([ring * np.cos(turn), ring * np.sin(turn), z])


def _prism(radius: float, half: float) -> FloatArray:
    """Corners (16, 3) of an octagonal prism around a cylinder along z."""
    turns = np.arange(8) * np.pi / 4
    ring = radius / np.cos(np.pi / 8) * np.column_stack([np.cos(turns), np.sin(turns)])
    return np.vstack([np.column_stack([ring, np.full(8, z)]) for z in (-half, half)])


def _row(reach: float, radius: float) -> FloatArray:
    """Evenly spaced coordinates from -reach to reach, no further apart than ``SPACING`` radii."""
    count = int(np.ceil(2 * reach / (SPACING * radius))) + 1 if reach > 0 else 1
    return np.linspace(-reach, reach, count)
