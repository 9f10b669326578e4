"""``same_space``: whether an object fills the same space in two poses, as a round one does."""

from __future__ import annotations

import numpy as np

from planner.shapes import Shape
from planner.spatial import SE3

__all__ = ["same_space"]

SAMPLES, AROUND, SAME_SPACE = 500, 1.2, 1e-7
"""Points whose distances from an object in two poses are compared, how far around it they lie, in
its bounding radius, and the difference (m) that is none."""


def same_space(shape: Shape, one: SE3, other: SE3) -> bool:
    """Whether points all around are as far from an object in one pose as in another.

    Args:
        shape: The object's.
        one: Pose of the object, world.
        other: The other pose.
    """
    points = np.random.default_rng(0).uniform(-1.0, 1.0, size=(SAMPLES, 3))
    points = one.translation + AROUND * shape.bounding_radius * points
    seen = [
        shape.signed_distance((points - pose.translation) @ pose.rotation) for pose in (one, other)
    ]
    return bool(np.abs(seen[0] - seen[1]).max() < SAME_SPACE)
