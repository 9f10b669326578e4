"""A grasp task as text that another process can make the task from again.

Hands and NLPs cannot be sent between processes, and need not be: a worker makes each task once from
its text and keeps it. The text is also what a stored batch remembers of its tasks.
"""

from __future__ import annotations

import hashlib
import json

from pydantic import ValidationError

from planner.errors import FileFormatError
from planner.files import TaskData, task_data, task_from_data
from planner.hand import Hand
from planner.schema import faults_of
from planner.shapes import Mesh, Shape, shape_to_dict
from planner.task import GraspTask
from planner.threads import made_once

__all__ = ["label_of", "recipe_of", "shape_key", "task_of"]


def recipe_of(task: GraspTask) -> str:
    """A task as JSON that follows ``planner.files.TaskData``; equal tasks give equal text.

    Raises:
        TaskError: The hand was made in Python, so that no text can name it.
    """
    return task_data(task).model_dump_json()


@made_once(64)
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
    return task_from_data(data, hand)


@made_once(8)
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
