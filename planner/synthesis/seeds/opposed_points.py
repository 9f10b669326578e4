"""Places on a mesh where fingers can oppose each other: pairs of surface points, face to face.

From points spread over the surface one looks straight into the body until the other side: the first
one, of a wall, a handle or a rim, and the last one, across a hollow. Where that side faces back,
within the friction cone or nearly, the two points can be pressed against each other.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from planner.shapes import Mesh
from planner.spatial import FloatArray

__all__ = ["OpposedPairs", "opposed_pairs"]

SAMPLES = 600
"""Surface points from which one looks through the body."""

STEP = 0.001
"""Step (m) of the look through the body: the thinnest wall that is found is twice as thick."""

FACING = float(np.cos(np.deg2rad(35.0)))
"""Smallest cosine between the line through both points and each normal: a little more than a
friction cone of 0.5 (27 degrees), since contacts move while the programme is solved."""


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
    points, normals = mesh.surface_samples(SAMPLES, np.random.default_rng(0))
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
    return OpposedPairs(
        centers=(points + width[:, None] / 2 * directions)[back],
        directions=directions[back],
        widths=width[back],
    )
