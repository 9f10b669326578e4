"""Where an object comes to lie when it is lowered on what carries it, by the true geometry.

A scan that is turned by some degrees lies higher or lower on the same walls, by hundredths of a
millimetre for round ones and by millimetres for others.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planner.collision.pair_table import shape_pair
from planner.shapes import Box, Shape
from planner.spatial import SE3
from planner.task import Obstacle

APART = 1e-6
"""Distance (m) from what carries it at which the object lies on it; it must not be in it."""

HALVINGS = 20
"""Halvings of the range of heights: a few centimetres to less than a micrometre."""


def lift_to_rest(
    shape: Shape,
    T_world_object: SE3,
    carrying: Sequence[Obstacle],
    lowest: float,
    highest: float,
) -> float | None:
    """How far up (m) an object must go from a pose to lie on obstacles, touching none.

    Args:
        shape: Of the object.
        T_world_object: Its pose; only its height changes.
        carrying: What it is to lie on.
        lowest: Where to look first, m; negative is below the pose.
        highest: Where to look last, m.

    Returns:
        The lift; ``lowest`` where it touches nothing there; None where it is in an obstacle even at
        ``highest``.
    """
    pairs = [
        (shape_pair(Box((o.size[0], o.size[1], o.size[2])).coal_geometry(), shape), o)
        for o in carrying
    ]

    def free(lift: float) -> bool:
        there = SE3(
            T_world_object.rotation, T_world_object.translation + np.array([0.0, 0.0, lift])
        )
        apart = (pair.distance(o.T_world_obstacle, there) for pair, o in pairs)
        return min(apart, default=np.inf) > APART

    low, high = lowest, highest
    if free(low):
        return low
    if not free(high):
        return None
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        low, high = (low, middle) if free(middle) else (middle, high)
    return high
