"""A grasp task as text that another process can make the task from again.

Hands and problems cannot be sent between processes: a worker makes each task once from its text and
keeps it. Stored batches hold the same text. It gives the same task to the last bit, so that a
request is planned as ``plan_grasp`` plans it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from pydantic import Field, ValidationError

from planner.errors import FileFormatError
from planner.files import TaskData, task_data, task_from_data
from planner.files.data import Finite, PoseData
from planner.forces.grip import ExpectedLoad
from planner.hand_loading import load_hand
from planner.hands.hand import Hand
from planner.schema import StrictData, faults_of
from planner.spatial import SE3
from planner.system.threads import made_once
from planner.task import GraspTask


class Recipe(StrictData):
    """A task before its search: the task of a plan file, and what only the search needs.

    Attributes:
        task: As in plan files.
        may_spare_fingers: Whether the search may go on with fewer fingers.
        expected_load: Force (N) and torque (N m) that fewer fingers are to bear too.
        joint_error: Standard deviation of each joint's encoder error, rad.
        rotations: Rotation matrices, row by row, of poses that quaternions give to rounding alone.
    """

    task: TaskData
    may_spare_fingers: bool = False
    expected_load: tuple[Finite, Finite] = (0.0, 0.0)
    joint_error: Finite = 0.0
    rotations: dict[str, list[Finite]] = Field(default_factory=dict)

    @classmethod
    def of(cls, task: GraspTask) -> Recipe:
        """Of a task.

        Raises:
            TaskError: The hand was made in Python, so that no text can name it.
        """
        return cls(
            task=task_data(task),
            may_spare_fingers=task.may_spare_fingers,
            expected_load=(task.expected_load.force, task.expected_load.torque),
            joint_error=task.joint_error,
            rotations={
                name: pose.rotation.ravel().tolist()
                for name, pose in _poses(task).items()
                if (PoseData.of(pose).pose().rotation != pose.rotation).any()
            },
        )

    def made(self, hand: Hand) -> GraspTask:
        """The task, for its hand."""
        task = task_from_data(self.task, hand)
        exact: dict[str, Any] = {
            name: SE3(np.array(self.rotations[name]).reshape(3, 3), pose.translation)
            if name in self.rotations
            else pose
            for name, pose in _poses(task).items()
        }
        obstacles = tuple(
            replace(o, T_world_obstacle=exact.pop(f"obstacle {k}"))
            for k, o in enumerate(task.obstacles)
        )
        force, torque = self.expected_load
        return replace(
            task,
            obstacles=obstacles,
            may_spare_fingers=self.may_spare_fingers,
            expected_load=ExpectedLoad(force=force, torque=torque),
            joint_error=self.joint_error,
            **exact,
        )


def _poses(task: GraspTask) -> dict[str, SE3]:
    """The poses of a task by their attribute, or by the name of their obstacle."""
    poses = {"T_world_object": task.T_world_object}
    if task.T_world_base is not None:
        poses["T_world_base"] = task.T_world_base
    return poses | {f"obstacle {k}": o.T_world_obstacle for k, o in enumerate(task.obstacles)}


def recipe_of(task: GraspTask) -> str:
    """A task as JSON that follows ``Recipe``; equal tasks give equal text.

    Raises:
        TaskError: The hand was made in Python, so that no text can name it.
    """
    # without an error the text is that of batches made before there was one
    left_out = None if task.joint_error else {"joint_error"}
    return Recipe.of(task).model_dump_json(exclude=left_out)


@made_once(64)
def task_of(recipe: str) -> GraspTask:
    """The task that ``recipe_of`` wrote; made once per process.

    Raises:
        FileFormatError: The text is damaged, or the hand's files have changed since.
        PlannerError: Hand or object cannot be loaded.
    """
    try:
        data = Recipe.model_validate_json(recipe)
    except ValidationError as error:
        raise FileFormatError(f"the task of a batch is damaged: {faults_of(error)}") from error
    given = data.task.hand
    hand = _hand(given.description_path or given.name)
    hand = hand.rolling if given.rolling else hand
    if hand.digest != given.sha256:
        raise FileFormatError(
            f"the batch was planned for a different {given.name!r} than {hand.reference}: its "
            "files have changed since; start a new batch, or bring the old files back"
        )
    return data.made(hand)


def with_fingers_of(task: GraspTask, row: Mapping[str, Any]) -> GraspTask:
    """The task of a row with a grasp: for the fingers of that grasp.

    Args:
        task: The task of the row's object.
        row: A row of a dataset.
    """
    names = row.get("fingers")  # rows of the first version have all that the task names
    if names is None or tuple(names) == task.finger_names:
        return task
    return _with_fingers(task, tuple(names))


@made_once(64)
def _with_fingers(task: GraspTask, names: tuple[str, ...]) -> GraspTask:
    return task.with_fingers(names)


@made_once(8)
def _hand(name: str) -> Hand:
    """One hand for all tasks with it, so that they share its problems."""
    return load_hand(name, download=False)


def label_of(task: GraspTask) -> str:
    """Label of an object in a batch: its name, or kind and sizes if it has no other name."""
    item = task.object
    return item.shape.spec if item.name == item.shape.kind else item.name
