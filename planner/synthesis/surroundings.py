"""Table and obstacles as parameters of the NLPs, all in the object's frame."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np

from planner.spatial import SE3, FloatArray
from planner.synthesis.clearance import ClearanceTerms
from planner.task import GraspTask

__all__ = ["Surroundings", "obstacles_in_object", "table_in_object"]

NO_TABLE = 10.0
"""Distance (m) at which the NLPs put the table when there is none: beyond any hand."""


class Surroundings:
    """Symbols of a table plane and of a number of boxes; the clearance of a hand from them."""

    def __init__(self, n_obstacles: int) -> None:
        """Make the symbols."""
        self._normal, self._offset = ca.SX.sym("table_n", 3), ca.SX.sym("table_d")
        self._boxes = [
            (ca.SX.sym("R_ob", 3, 3), ca.SX.sym("t_ob", 3), ca.SX.sym("h_ob", 3))
            for _ in range(n_obstacles)
        ]

    @property
    def symbols(self) -> Any:
        """All of them, a column, in the order of ``values``."""
        boxes = [v for r, t, h in self._boxes for v in (ca.vec(r), t, h)]
        return ca.vertcat(self._normal, self._offset, *boxes)

    @staticmethod
    def values(
        table: tuple[FloatArray, float], obstacles: Sequence[tuple[SE3, FloatArray]]
    ) -> FloatArray:
        """Numbers for the symbols.

        Args:
            table: Unit normal (3,) and offset d; points above the table have n . x - d >= 0.
            obstacles: Pose and half extents (3,), m, of each box.
        """
        parts: list[Any] = [table[0], [table[1]]]
        for pose, half in obstacles:
            inverse = pose.inverse()
            parts += [np.array(inverse.rotation).ravel(order="F"), inverse.translation, half]
        return np.concatenate([np.asarray(v, dtype=np.float64).ravel() for v in parts])

    def from_table(self, links: ClearanceTerms, margin: Any) -> list[Any]:
        """Height of every link over the table less a margin (m)."""
        return links.from_plane(self._normal, self._offset, margin)

    def from_obstacles(self, links: ClearanceTerms, margin: Any) -> list[Any]:
        """Distance of every link from every box less a margin (m)."""
        return [row for r, t, h in self._boxes for row in links.from_box(r, t, h, margin)]


def table_in_object(task: GraspTask) -> tuple[FloatArray, float]:
    """Table plane in the object's frame: unit normal (3,) and offset, m."""
    inverse = task.T_world_object.inverse()
    normal = inverse.rotation @ np.array([0.0, 0.0, 1.0])
    if task.table_height is None:
        return normal, -NO_TABLE
    on_table = inverse.act(np.array([0.0, 0.0, task.table_height]))
    return normal, float(normal @ on_table)


def obstacles_in_object(task: GraspTask) -> list[tuple[SE3, FloatArray]]:
    """Pose in the object's frame and half extents (3,), m, of every obstacle."""
    to_object = task.T_world_object.inverse()
    return [(to_object * o.T_world_obstacle, o.size / 2) for o in task.obstacles]
