"""Files of handovers: the task, and the grasps of both hands alone, each as in a plan file.

Reading puts the two grasps together anew, with every check of planning.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal, Self

from pydantic import Field, model_validator

from planner.errors import FileFormatError
from planner.failure import Failure
from planner.files.data import TaskData, task_data, task_from_data
from planner.files.disk import checked_file, read_json, write_json
from planner.files.plans import given_hand, plan_from_dict, plan_to_dict
from planner.motion.handover import HandoverPlan, put_together
from planner.schema import StrictData
from planner.system.package import written_by


class HandoverFile(StrictData):
    """A handover as JSON; version 2 was planned for joints that may be off."""

    format: Literal["opposable-handover"] = "opposable-handover"
    version: Literal[1, 2] = 1
    written_by: str
    task: TaskData
    to: str
    lift_height_m: float = Field(gt=0, allow_inf_nan=False)
    give: dict[str, Any]
    take: dict[str, Any]

    @model_validator(mode="after")
    def _of_version(self) -> Self:
        if (self.task.joint_error_rad is not None) != (self.version == 2):
            raise ValueError("joint_error_rad is in version 2 alone, and every task there has it")
        return self


def write_handover(plan: HandoverPlan, path: Path | str) -> None:
    """Write a handover file; a whole one or none.

    Raises:
        TaskError: A hand was made in Python, so that no file can name it.
        FileFormatError: The file cannot be written.
    """
    give, take = (plan_to_dict(grasp) for grasp in plan.alone)
    file = HandoverFile(
        version=2 if plan.task.joint_error else 1,
        written_by=written_by(),
        task=task_data(plan.task),
        to=plan.taker,
        lift_height_m=plan.lift_height,
        give=give,
        take=take,
    )
    write_json(file.model_dump(mode="json"), path)


def read_handover(path: Path | str) -> HandoverPlan:
    """Read a handover file and check it as when it was planned.

    Raises:
        FileFormatError: Damaged, of another version, for other hands, or no handover.
        PlannerError: A hand or the object cannot be loaded.
    """
    return handover_from_dict(read_json(path, "handover file"), str(path))


def handover_from_dict(data: dict[str, Any], source: str) -> HandoverPlan:
    """The handover that plain data hold, checked like a file; errors as ``read_handover``."""
    file = checked_file(HandoverFile, data, source)
    task = task_from_data(file.task, given_hand(file.task.hand, source))
    give, take = (
        plan_from_dict(grasp, f"{source}, {name}")
        for name, grasp in (("give", file.give), ("take", file.take))
    )
    found = put_together(task, give, take, to=file.to, lift_height=file.lift_height_m)
    if isinstance(found, Failure):
        raise FileFormatError(f"{source} holds a handover that fails its checks: {found.text}")
    return found
