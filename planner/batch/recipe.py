"""A task as text, the recipe; and the manifest of a stored batch.

A grasp task as text that another process can make the task from again.

Hands and problems cannot be sent between processes: a worker makes each task once from its text and
keeps it. Stored batches hold the same text. It gives the same task to the last bit, so that a
request is planned as ``plan_grasp`` plans it.

The manifest of a stored batch: everything that its rows depend on.

A batch goes on only under the manifest it began with, so that one folder never mixes two.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field, ValidationError

from planner.contacts.friction import ExpectedLoad
from planner.errors import FileFormatError
from planner.files import TaskData, read_json, task_data, task_from_data
from planner.files.data import PoseData
from planner.files.disk import refuse_other_request
from planner.hand_loading import load_hand
from planner.hands.hand import Hand
from planner.schema import Finite, StrictData, faults_of
from planner.spatial import SE3
from planner.system.threads import made_once
from planner.task import GraspTask


class Recipe(StrictData):
    """A task before its search: the task of a plan file, and what only the search needs.

    Attributes:
        task: As in plan files.
        may_spare_fingers: Whether the search may go on with fewer fingers.
        alternatives: Other sets of contacts that the search may use.
        expected_load: Force (N) and torque (N m) that fewer fingers are to bear too.
        joint_error: Standard deviation of each joint's encoder error, rad.
        rotations: Rotation matrices, row by row, of poses that quaternions give to rounding alone.
    """

    task: TaskData
    may_spare_fingers: bool = False
    alternatives: tuple[tuple[str, ...], ...] = ()
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
            task=task_data(replace(task, joint_error=0.0)),  # which stands beside it
            may_spare_fingers=task.may_spare_fingers,
            alternatives=task.alternatives,
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
            alternatives=self.alternatives,
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
    # without them the text is that of batches made before there were such things
    values = {"joint_error": task.joint_error, "alternatives": task.alternatives}
    left_out = {name for name, value in values.items() if not value}
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


MANIFEST = "manifest.json"
"""Name of the file."""

SHARD_ROWS = 1000
"""Rows per Parquet file, about 1 MB: few files for many grasps, and few rows in memory."""


class ManifestObject(Recipe):
    """One object: its label and its task."""

    label: str

    @property
    def recipe(self) -> str:
        """The task as text, see ``planner.batch.recipe``."""
        return Recipe(**{k: getattr(self, k) for k in Recipe.model_fields}).model_dump_json()


class Manifest(StrictData):
    """The request of a batch.

    Version 1, whose rows name neither their manifest nor their fingers, is read, but not continued.
    """

    format: Literal["opposable-grasps"] = "opposable-grasps"
    version: Literal[1, 2] = 2
    written_by: str
    hand: str
    joint_names: list[str]
    n: int
    seed: int
    max_attempts: int
    max_cpu_s: float | None = None
    options: dict[str, Any]
    shard_rows: int = SHARD_ROWS
    objects: list[ManifestObject]

    @property
    def digest(self) -> str | None:
        """SHA-256 by which rows name their manifest, hexadecimal; None for version 1."""
        return None if self.version == 1 else sha256(self.model_dump_json().encode()).hexdigest()

    @property
    def total(self) -> int:
        """Requested grasps of all objects."""
        return self.n * len(self.objects)

    @property
    def n_shards(self) -> int:
        """Files that hold all rows."""
        return -(-self.total // self.shard_rows)

    def rows_in(self, shard: int) -> int:
        """Rows of a complete shard."""
        return min(self.shard_rows, self.total - shard * self.shard_rows)

    def refuse_unless_same(self, asked: Manifest, folder: Path) -> None:
        """Refuse another request than the one that the folder was begun with.

        Raises:
            FileFormatError: Another request; lists the differences.
        """
        refuse_other_request(
            folder, "batch", self.model_dump(mode="json"), asked.model_dump(mode="json")
        )


def read_manifest(folder: Path) -> Manifest:
    """The manifest of a folder.

    Raises:
        FileFormatError: There is none, or it is damaged.
    """
    try:
        return Manifest.model_validate(read_json(folder / MANIFEST, "the manifest of a batch"))
    except ValidationError as error:
        raise FileFormatError(f"{folder / MANIFEST} is damaged: {faults_of(error)}") from error
