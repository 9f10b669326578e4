"""A grasp task as text that another process can make the task from again.

Hands and NLPs cannot be sent between processes, and need not be: a worker makes each task once from
its text and keeps it. The text is also what a stored batch remembers of its tasks.
"""

from __future__ import annotations

import hashlib
import json
from functools import lru_cache

import numpy as np
from pydantic import ValidationError

from planner.catalog import hand_names
from planner.errors import FileFormatError, TaskError
from planner.files import HandData, ObjectData, ObstacleData, PoseData, TaskData, TouchData
from planner.hand import Hand
from planner.objects import GraspObject
from planner.schema import faults_of
from planner.shapes import Mesh, Shape, shape_from_dict, shape_to_dict
from planner.task import GraspTask, Obstacle

__all__ = ["label_of", "recipe_of", "shape_key", "task_of"]


def recipe_of(task: GraspTask) -> str:
    """A task as JSON that follows ``planner.files.TaskData``; equal tasks give equal text.

    Raises:
        TaskError: The hand was made in Python, so that no text can name it.
    """
    hand = task.hand
    if hand.reference is None:
        raise TaskError(
            f"{hand.name} was made in Python, so other processes cannot load it; write its model "
            "and its description to files and load it from there"
        )
    base = task.T_world_base
    data = TaskData(
        hand=HandData(
            name=hand.name,
            description_path="" if hand.reference in hand_names() else hand.reference,
            sha256=hand.digest,
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
        T_world_base_fixed=None if base is None else PoseData.of(base),
        wrist_free=task.wrist_free,
        wrist_q_rad=list(task.wrist_q),
    )
    return data.model_dump_json()


@lru_cache(maxsize=64)
def task_of(recipe: str) -> GraspTask:
    """The task that ``recipe_of`` wrote; made once per process.

    Raises:
        FileFormatError: The text is damaged, or the hand's files have changed since.
        PlannerError: Hand or object cannot be loaded.
    """
    try:
        data = TaskData.model_validate_json(recipe)
    except ValidationError as error:
        raise FileFormatError(f"the task of a batch is damaged: {faults_of(error)}") from error
    hand = _hand(data.hand.description_path or data.hand.name)
    if hand.digest != data.hand.sha256:
        raise FileFormatError(
            f"the batch was planned for a different {data.hand.name!r} than {hand.reference}: its "
            "files have changed since; start a new batch, or bring the old files back"
        )
    base = data.T_world_base_fixed
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
        T_world_base=None if base is None else base.pose(),
        wrist_free=data.wrist_free,
        wrist_q=np.array(data.wrist_q_rad),
    )


@lru_cache(maxsize=8)
def _hand(name: str) -> Hand:
    """One hand for all tasks with it, so that they share its NLPs."""
    return Hand.load(name)


def label_of(task: GraspTask) -> str:
    """What an object is called in a batch: its name, or kind and sizes if it has no other name."""
    item = task.object
    return item.shape.spec if item.name == item.shape.kind else item.name


def shape_key(shape: Shape) -> str:
    """What identifies a shape wherever its file is: SHA-256, hexadecimal."""
    if isinstance(shape, Mesh) and shape.kind == Mesh.kind:
        return shape.digest
    return hashlib.sha256(json.dumps(shape_to_dict(shape), sort_keys=True).encode()).hexdigest()
