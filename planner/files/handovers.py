"""Handovers in files: the task of the pair, and the grasps of both hands alone, as in plan files.

Reading puts the two grasps together anew, with every check of planning. A handover is kept in a
movement file; files of its own format, ``opposable-handover``, are read as well.
"""

from __future__ import annotations

from typing import Any, Literal, Self

from pydantic import Field, model_validator

from planner.errors import FileFormatError
from planner.failure import Failure
from planner.files.data import LaterData, PoseData, TaskData, task_data, task_from_data
from planner.files.plans import given_hand, plan_from_dict, plan_to_dict
from planner.motion.handover import put_together
from planner.motion.phase import Handover
from planner.motion.plan import ManipulationPlan


class HandoverData(LaterData):
    """What a handover is put together from; where the pair's base is not told it is found again."""

    later = "T_world_pair"

    task: TaskData
    to: str
    lift_height_m: float = Field(gt=0, allow_inf_nan=False, strict=True)
    give: dict[str, Any]
    take: dict[str, Any]
    T_world_pair: PoseData | None = None

    @classmethod
    def of(cls, handover: Handover) -> HandoverData:
        """From a handover.

        Raises:
            TaskError: A hand was made in Python, so that no file can name it.
        """
        give, take = (plan_to_dict(grasp) for grasp in handover.alone)
        return cls(
            task=task_data(handover.task),
            to=handover.taker,
            lift_height_m=handover.lift_height,
            give=give,
            take=take,
            T_world_pair=PoseData.of(handover.both.T_world_base),
        )

    def movement(self, source: str) -> ManipulationPlan:
        """The movement, put together and checked.

        Raises:
            FileFormatError: It fails its checks now, or is for other hands.
            PlannerError: A hand or the object cannot be loaded.
        """
        task = task_from_data(self.task, given_hand(self.task.hand, source))
        give, take = (
            plan_from_dict(grasp, f"{source}, {name}")
            for name, grasp in (("give", self.give), ("take", self.take))
        )
        found = put_together(
            task,
            give,
            take,
            to=self.to,
            lift_height=self.lift_height_m,
            T_world_pair=None if self.T_world_pair is None else self.T_world_pair.pose(),
        )
        if isinstance(found, Failure):
            raise FileFormatError(f"{source} holds a handover that fails its checks: {found.text}")
        return found


class HandoverFile(HandoverData):
    """A handover in a file of its own; version 2 was planned for joints that may be off."""

    format: Literal["opposable-handover"] = "opposable-handover"
    version: Literal[1, 2] = 1
    written_by: str

    @model_validator(mode="after")
    def _of_version(self) -> Self:
        if (self.task.joint_error_rad is not None) != (self.version == 2):
            raise ValueError("joint_error_rad is in version 2 alone, and every task there has it")
        return self
