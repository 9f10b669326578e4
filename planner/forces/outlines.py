"""Pyramids around and inside the round cones of a problem, so that linear programmes can judge it.

With unit directions d of the tails, no direction further than an angle a from one of them,

    outer    d . tail <= head          for every d: holds wherever |tail| <= head does
    inner    d . tail <= cos(a) head   for every d: |tail| <= head wherever it holds
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from planner.forces.problem import ForceProblem
from planner.spatial import FloatArray

__all__ = ["outlined"]

SIDES = 64
"""Directions of a tail of two (-): inner and outer are 0.12 % apart."""

RINGS = 12
"""Rings of directions of a tail of three (-), 24 directions each: 1.7 % apart at most."""


def outlined(problem: ForceProblem, *, inner: bool) -> ForceProblem:
    """The problem with pyramids in place of its round cones."""
    faces, names, start = [problem.faces], list(problem.face_names), 0
    for size, name in zip(problem.cone_sizes, problem.cone_names, strict=True):
        block = problem.cones[start : start + size]
        start += size
        directions, reach = _directions(size - 1)
        faces.append(directions @ block[1:] - (reach if inner else 1.0) * block[0])
        names += [name] * len(directions)
    return replace(
        problem,
        faces=np.vstack(faces),
        face_names=tuple(names),
        cones=problem.cones[:0],
        cone_sizes=(),
        cone_names=(),
    )


def _directions(dimension: int) -> tuple[FloatArray, float]:
    """Unit directions (m, dimension), and the cosine of the angle within which one is near."""
    if dimension == 1:
        return np.array([[1.0], [-1.0]]), 1.0
    if dimension == 2:
        angle = 2 * np.pi * np.arange(SIDES) / SIDES
        return np.stack([np.cos(angle), np.sin(angle)], axis=1), float(np.cos(np.pi / SIDES))
    half = np.pi / (2 * RINGS)  # half a cell of the grid, in latitude and in longitude
    latitude = -np.pi / 2 + half * (2 * np.arange(RINGS) + 1)
    longitude = half * np.arange(0, 4 * RINGS, 2)
    up, around = (grid.ravel() for grid in np.meshgrid(latitude, longitude, indexing="ij"))
    points = np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)
    return np.stack(points, axis=1), float(np.cos(half) ** 2)
