"""How much of the space of orientations states cover: cells of equal volume on SO(3).

A rotation R is the direction u = R e_z and the angle psi by which R turns about u beyond the
shortest rotation that takes e_z to u. The grid has 6 bands of equal height along z, 12 sectors of
30 degrees around z, and 12 steps of 30 degrees in psi: 864 cells, each with the same share of
uniformly distributed rotations. About the axis of a round object psi means nothing: its coverage is
that of the 72 cells of directions.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from planner.spatial import FloatArray, IntArray

BANDS, SECTORS, TURNS = 6, 12, 12
"""Cells along z, around z, and of the turn about the direction."""


def direction_cells(directions: FloatArray) -> IntArray:
    """Cells (m,), 0 to 71, of unit vectors (m, 3)."""
    band = np.clip(np.floor((directions[:, 2] + 1.0) / 2.0 * BANDS), 0, BANDS - 1)
    around = np.arctan2(directions[:, 1], directions[:, 0]) / (2.0 * np.pi) % 1.0
    sector = np.clip(np.floor(around * SECTORS), 0, SECTORS - 1)
    return np.asarray(band * SECTORS + sector, dtype=np.int64)


def orientation_cells(rotations: FloatArray) -> IntArray:
    """Cells (m,), 0 to 863, of rotation matrices (m, 3, 3)."""
    u = rotations[:, :, 2]
    # the shortest rotation takes e_x to a vector that the formula gives away from u = -e_z
    below = np.maximum(1.0 + u[:, 2], 1e-12)
    first = np.stack([1.0 - u[:, 0] ** 2 / below, -u[:, 0] * u[:, 1] / below, -u[:, 0]], axis=1)
    second = np.cross(u, first)
    x = rotations[:, :, 0]
    psi = np.arctan2((x * second).sum(axis=1), (x * first).sum(axis=1)) / (2.0 * np.pi) % 1.0
    step = np.clip(np.floor(psi * TURNS), 0, TURNS - 1).astype(np.int64)
    return np.asarray(direction_cells(u) * TURNS + step, dtype=np.int64)


def coverage(rotations: FloatArray, gravity: FloatArray) -> dict[str, Any]:
    """How many cells states reach, as plain data.

    Args:
        rotations: Orientations of the object in the palm (m, 3, 3).
        gravity: Directions of gravity in the palm (m, 3), any length.
    """
    down = gravity / np.linalg.norm(gravity, axis=1, keepdims=True)
    return {
        "orientations_of_object_in_palm": _counts(
            orientation_cells(rotations), BANDS * SECTORS * TURNS
        ),
        "directions_of_object_axis_in_palm": _counts(
            direction_cells(rotations[:, :, 2]), BANDS * SECTORS
        ),
        "directions_of_gravity_in_palm": _counts(direction_cells(down), BANDS * SECTORS),
    }


def _counts(cells: IntArray, total: int) -> dict[str, Any]:
    """Cells reached, of how many, and the states in a cell that is reached: median and most."""
    counts = np.bincount(cells, minlength=total)
    reached = counts[counts > 0]
    return {
        "cells": total,
        "reached": len(reached),
        "share": len(reached) / total,
        "median_states_in_a_reached_cell": float(np.median(reached)) if len(reached) else 0.0,
        "most_states_in_a_cell": int(counts.max()),
    }
