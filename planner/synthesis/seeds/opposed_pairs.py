"""Pairs of opposed surface points of a mesh, between which pads can press.

Pairs are found along rays through the body, from points spread over the surface: at the first exit,
of a wall, a handle or a rim, and at the last one, across a hollow. Where the other side faces back,
within the friction cone or nearly, the two points can be pressed against each other.

On a solid, rays run against the normals through the smooth distance, whose normals are even where a
scan is rough. It has no walls thinner than its grid: on those, rays pass through the triangles. A
second ray of each point is tilted there, since the sides of bowls and cups lean.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from planner.shapes import Mesh
from planner.spatial import FloatArray

SAMPLES = 600
"""Surface points from which rays go through the body."""

STEP = 0.001
"""Step (m) along a ray through the smooth distance."""

FACING = float(np.cos(np.deg2rad(35.0)))
"""Smallest cosine between the line through both points and each normal: a little more than a
friction cone of 0.5 (27 degrees), since the solver moves contacts."""

TILT = 0.45
"""Sine of the largest angle (27 degrees) between a normal and the second ray of its point. On a
bowl that lies upside down, 100 mm wide, the Allegro-type hand found 18.6 grasps per CPU second with
it and 0.2 without. On solids it does not help: of 20 attempts at a hammer 5 found a grasp, not 10.
"""


@dataclass(frozen=True, kw_only=True, eq=False)
class OpposedPairs:
    """Pairs of opposed surface points, in the object's frame.

    Attributes:
        centers: (n, 3), half-way between, m.
        directions: (n, 3), unit, from one point to the other.
        widths: (n,), distance of the two, m.
    """

    centers: FloatArray
    directions: FloatArray
    widths: FloatArray


@lru_cache(maxsize=16)
def opposed_pairs(mesh: Mesh) -> OpposedPairs:
    """Opposed pairs of a mesh; always the same ones."""
    rng = np.random.default_rng(0)
    points, normals = mesh.surface_samples(SAMPLES, rng)
    if not mesh.thin_walled:
        return _through_field(mesh, points, normals)
    tilt = rng.normal(size=normals.shape)
    tilt *= TILT / np.linalg.norm(tilt, axis=1, keepdims=True)
    tilted = tilt - normals
    tilted /= np.linalg.norm(tilted, axis=1, keepdims=True)
    return _through_triangles(mesh, np.vstack([points, points]), np.vstack([-normals, tilted]))


def _through_triangles(mesh: Mesh, points: FloatArray, directions: FloatArray) -> OpposedPairs:
    """Pairs along rays from surface points (n, 3), m, in unit directions (n, 3)."""
    ray, depth, across = mesh.pierced(points, directions)
    facing = np.einsum("ij,ij->i", across, directions[ray])
    ray, depth, facing = (v[facing > 0.0] for v in (ray, depth, facing))  # where rays leave
    first = np.flatnonzero(np.diff(ray, prepend=-1))
    last = np.flatnonzero(np.diff(ray, append=-1))
    exits = np.concatenate([first, last[last > first]])
    exits = exits[facing[exits] >= FACING]
    return _pairs(points[ray[exits]], directions[ray[exits]], depth[exits])


def _through_field(mesh: Mesh, points: FloatArray, normals: FloatArray) -> OpposedPairs:
    """Pairs along rays from surface points (n, 3), m, against their normals (n, 3)."""
    field = mesh.field()
    depths = np.arange(STEP, 2 * mesh.bounding_radius, STEP)
    first, last = np.zeros(len(points)), np.zeros(len(points))
    before = np.full(len(points), -STEP)
    for depth in depths:
        value = field.taylor(points - depth * normals, 0)[:, 0]
        out = (before < 0.0) & (value >= 0.0) & (depth > STEP)
        share = value / np.where(out, value - before, 1.0)
        last[out] = (depth - STEP * np.clip(share, 0.0, 1.0))[out]
        first[out & (first == 0.0)] = last[out & (first == 0.0)]
        before = value
    through = last > first
    points = np.vstack([points, points[through]])
    directions = -np.vstack([normals, normals[through]])
    width = np.concatenate([first, last[through]])
    found = width > 0.0
    points, directions, width = points[found], directions[found], width[found]
    gradients = field.taylor(points + width[:, None] * directions, 1)[:, 1:4]
    gradients /= np.maximum(np.linalg.norm(gradients, axis=1, keepdims=True), 1e-9)
    back = np.einsum("ij,ij->i", gradients, directions) >= FACING
    return _pairs(points[back], directions[back], width[back])


def _pairs(points: FloatArray, directions: FloatArray, widths: FloatArray) -> OpposedPairs:
    centers = points + widths[:, None] / 2 * directions
    return OpposedPairs(centers=centers, directions=directions, widths=widths)
