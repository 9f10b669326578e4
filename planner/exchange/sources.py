"""What there is to export: plan files of any kind, folders of them, and grasps of batches."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import Any, TypeAlias

from planner.batch.dataset import GraspSet
from planner.batch.manifest import MANIFEST
from planner.errors import FileFormatError, NotFoundError, TaskError, shown
from planner.files import (
    plan_files,
    read_gait,
    read_json,
    read_manipulation,
    read_motion,
    read_plan,
)
from planner.motion.gait.plan import GaitPlan
from planner.motion.manipulation.plan import ManipulationPlan
from planner.motion.plan import MotionPlan
from planner.plan import GraspPlan
from planner.task import GraspTask

AnyPlan: TypeAlias = GraspPlan | MotionPlan | GaitPlan | ManipulationPlan
"""What has a joint trajectory."""

_READERS: dict[str, Callable[[Path], AnyPlan]] = {
    "opposable-plan": read_plan,
    "opposable-motion": read_motion,
    "opposable-gait": read_gait,
    "opposable-manipulation": read_manipulation,
}
"""Format that a file says of itself -> its reader."""


def task_of_plan(plan: AnyPlan) -> GraspTask:
    """The task of a plan of any kind."""
    if isinstance(plan, GraspPlan):
        return plan.task
    return plan.motion.grasp.task if isinstance(plan, GaitPlan) else plan.grasp.task


def plans_of(
    paths: Sequence[Path], *, objects: Sequence[str] | None = None, first: int | None = None
) -> Iterator[AnyPlan]:
    """Plans of files and of folders of batches, each verified again as it is read.

    Args:
        paths: Plan files, folders of plan files, and folders that ``plan_grasps`` wrote.
        objects: Labels of the objects of a batch that are wanted; all if None.
        first: At most so many grasps of each object of a batch; all if None.

    Raises:
        NotFoundError: There is no such file, or a batch has no such object.
        FileFormatError: A file is no plan, is damaged, or fails its checks now.
        TaskError: Objects or a number are given without a batch.
    """
    batches = [path for path in paths if (path / MANIFEST).is_file()]
    if not batches and (objects is not None or first is not None):
        raise TaskError(
            "objects and the number of grasps choose from a batch, and no folder of a batch is "
            "given; leave them out, or give the folder"
        )
    for path in paths:
        if path in batches:
            yield from _of_batch(GraspSet(path), objects, first)
        elif not path.exists():
            raise NotFoundError(
                "file", str(path), (), "give plan files, or the folder of a batch", is_path=True
            )
        elif path.is_dir():
            files = plan_files(path, _READERS)
            if not files:
                raise FileFormatError(
                    f"{path} holds neither plan files nor a batch; give plan files, a folder of "
                    "them, or the folder of a batch"
                )
            yield from map(_of_file, files)
        else:
            yield _of_file(path)


def _of_batch(
    grasps: GraspSet, objects: Sequence[str] | None, first: int | None
) -> Iterator[GraspPlan]:
    for label in objects or ():
        if label not in grasps.labels:
            raise NotFoundError("object of the batch", label, grasps.labels)
    for label in grasps.labels if objects is None else objects:
        for number, _ in islice(grasps.found(label), first):
            yield grasps.plan(number)


def _of_file(path: Path) -> AnyPlan:
    data: dict[str, Any] = read_json(path, "a plan")
    read = _READERS.get(str(data.get("format")))
    if read is None:
        raise FileFormatError(
            f"{path} is of the format {shown(data.get('format'))}; what can be exported is "
            f"{', '.join(_READERS)}, folders of these, and of batches"
        )
    return read(path)
