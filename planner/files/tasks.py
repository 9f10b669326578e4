"""A task as data and back: part of every plan file and of every batch manifest."""

from __future__ import annotations

import numpy as np

from planner.errors import TaskError
from planner.files.data import (
    HandData,
    ObjectData,
    ObstacleData,
    PoseData,
    TaskData,
    TouchData,
)
from planner.hands.catalog import hand_names
from planner.hands.hand import Hand
from planner.objects import GraspObject
from planner.shapes import shape_from_dict, shape_to_dict
from planner.task import GraspTask, Obstacle


def task_data(task: GraspTask) -> TaskData:
    """A task as data; its fingers are those it has, none to be spared later.

    Raises:
        TaskError: The hand was made in Python, so that no file can name it.
    """
    hand = task.hand
    if hand.reference is None:
        raise TaskError(
            f"{hand.name} was made in Python, so no file can name it; write its model and its "
            "description to files and load it from there"
        )
    path = "" if hand.reference in hand_names() else hand.reference
    return TaskData(
        hand=HandData(
            name=hand.name, description_path=path, sha256=hand.digest, rolling=hand.rolls
        ),
        object=ObjectData(
            name=task.object.name,
            shape=shape_to_dict(task.object.shape),
            mass_kg=task.object.mass,
            touch=TouchData.of(task.object.touch),
        ),
        T_world_object=PoseData.of(task.T_world_object),
        table_height_m=task.table_height,
        obstacles=[
            ObstacleData(
                name=o.name,
                size_m=tuple(o.size),
                T_world_obstacle=PoseData.of(o.T_world_obstacle),
            )
            for o in task.obstacles
        ],
        gravity_m_s2=tuple(task.gravity),
        mu=task.mu,
        mu_torsion_m=task.mu_torsion,
        contact_model=task.contact_model,
        fingers=list(task.finger_names),
        grip_force_N=task.grip_force,
        T_world_base_fixed=None if task.T_world_base is None else PoseData.of(task.T_world_base),
        wrist_free=task.wrist_free,
        wrist_q_rad=list(task.wrist_q),
    )


def task_from_data(data: TaskData, hand: Hand) -> GraspTask:
    """The task that ``task_data`` wrote, for its hand."""
    return GraspTask(
        hand=hand,
        object=GraspObject(
            name=data.object.name,
            shape=shape_from_dict(data.object.shape),
            mass=data.object.mass_kg,
            touch=None if data.object.touch is None else data.object.touch.touch(),
        ),
        T_world_object=data.T_world_object.pose(),
        table_height=data.table_height_m,
        obstacles=tuple(
            Obstacle(
                name=o.name, size=np.array(o.size_m), T_world_obstacle=o.T_world_obstacle.pose()
            )
            for o in data.obstacles
        ),
        gravity=np.array(data.gravity_m_s2),
        mu=data.mu,
        mu_torsion=data.mu_torsion_m,
        contact_model=data.contact_model,
        finger_names=tuple(data.fingers),
        grip_force=data.grip_force_N,
        T_world_base=None if data.T_world_base_fixed is None else data.T_world_base_fixed.pose(),
        wrist_free=data.wrist_free,
        wrist_q=np.array(data.wrist_q_rad),
    )
