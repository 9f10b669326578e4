"""Table and obstacles as parameters of the NLPs, all in the object's frame."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from planner.spatial import FloatArray
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
        self.boxes = [
            (ca.SX.sym("R_ob", 3, 3), ca.SX.sym("t_ob", 3), ca.SX.sym("h_ob", 3))
            for _ in range(n_obstacles)
        ]

    @property
    def table(self) -> Any:
        """Symbols of the table: unit normal and offset d; points above have n . x - d >= 0."""
        return ca.vertcat(self._normal, self._offset)

    @property
    def obstacles(self) -> Any:
        """Symbols of the obstacles: rotation, translation and half extents of each."""
        return ca.vertcat(*[v for r, t, h in self.boxes for v in (ca.vec(r), t, h)])

    def from_table(self, links: ClearanceTerms, margin: Any) -> list[Any]:
        """Height of every link over the table less a margin (m)."""
        return links.from_plane(self._normal, self._offset, margin)

    def from_obstacles(self, links: ClearanceTerms, margin: Any) -> list[Any]:
        """Distance of every link from every box less a margin (m)."""
        return [row for r, t, h in self.boxes for row in links.from_box(r, t, h, margin)]


def table_in_object(task: GraspTask) -> FloatArray:
    """Numbers (4,) for the table: unit normal in the object's frame, and offset, m."""
    inverse = task.T_world_object.inverse()
    normal = inverse.rotation @ np.array([0.0, 0.0, 1.0])
    if task.table_height is None:
        return np.append(normal, -NO_TABLE)
    on_table = inverse.act(np.array([0.0, 0.0, task.table_height]))
    return np.append(normal, normal @ on_table)


def obstacles_in_object(task: GraspTask) -> FloatArray:
    """Numbers (15 k,) for the obstacles: from the object's frame into that of each."""
    parts: list[FloatArray] = [np.zeros(0)]
    for obstacle in task.obstacles:
        inverse = obstacle.T_world_obstacle.inverse() * task.T_world_object
        parts += [inverse.rotation.ravel(order="F"), inverse.translation, obstacle.size / 2]
    return np.concatenate(parts)
