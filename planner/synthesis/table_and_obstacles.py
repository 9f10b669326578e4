"""Table and obstacles as parameters of the grasp problem, all in the object's frame."""

from __future__ import annotations

import numpy as np

from planner.spatial import FloatArray
from planner.task import GraspTask

NO_TABLE = 10.0
"""Distance (m) at which problems put the table when there is none: beyond any hand."""


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
