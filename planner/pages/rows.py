"""Poses as the rows of numbers that a page reads: x, y, z, qw, qx, qy, qz."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from planner.spatial import SE3, FloatArray, pose_to_wxyz

__all__ = ["IDENTITY_ROW", "pose_row", "pose_rows"]

IDENTITY_ROW = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
"""The pose of a frame in itself."""


def pose_row(pose: SE3) -> FloatArray:
    """A pose as (7,), m and a unit quaternion."""
    return np.concatenate(pose_to_wxyz(pose))


def pose_rows(poses: Iterable[SE3]) -> FloatArray:
    """Poses as (m, 7)."""
    return np.array([pose_row(p) for p in poses]).reshape(-1, 7)
