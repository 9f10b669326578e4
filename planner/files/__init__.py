"""Files that people and other programmes read: plans, contacts, trajectories.

What is public here is loaded when it is first used: a plan needs no movement.
"""

from typing import TYPE_CHECKING

from planner.system.package import lazy_names

if TYPE_CHECKING:
    from planner.files.data import PLAN_VERSION, PlanFile, TaskData, task_data, task_from_data
    from planner.files.disk import (
        format_told,
        plain_name,
        plan_files,
        read_json,
        whole_file,
        write_json,
        write_trajectory,
    )
    from planner.files.movements import (
        MovementFile,
        given_manipulation,
        read_gait,
        read_manipulation,
        read_motion,
        read_movement,
        write_gait,
        write_manipulation,
        write_motion,
        write_movement,
    )
    from planner.files.plans import (
        ContactsFile,
        given_plan,
        plan_from_dict,
        plan_to_dict,
        pose_of_plan,
        read_contacts,
        read_plan,
        write_plan,
    )

__all__ = [
    "PLAN_VERSION",
    "ContactsFile",
    "MovementFile",
    "PlanFile",
    "TaskData",
    "format_told",
    "given_manipulation",
    "given_plan",
    "plain_name",
    "plan_files",
    "plan_from_dict",
    "plan_to_dict",
    "pose_of_plan",
    "read_contacts",
    "read_gait",
    "read_json",
    "read_manipulation",
    "read_motion",
    "read_movement",
    "read_plan",
    "task_data",
    "task_from_data",
    "whole_file",
    "write_gait",
    "write_json",
    "write_manipulation",
    "write_motion",
    "write_movement",
    "write_plan",
    "write_trajectory",
]

_NAMES = {
    "planner.files.data": "PLAN_VERSION PlanFile TaskData task_data task_from_data",
    "planner.files.disk": (
        "format_told plain_name plan_files read_json whole_file write_json write_trajectory"
    ),
    "planner.files.movements": (
        "MovementFile given_manipulation read_gait read_manipulation read_motion read_movement "
        "write_gait write_manipulation write_motion write_movement"
    ),
    "planner.files.plans": (
        "ContactsFile given_plan plan_from_dict plan_to_dict pose_of_plan read_contacts read_plan "
        "write_plan"
    ),
}
"""Module -> the names that it defines."""

__getattr__, __dir__ = lazy_names(
    __name__, {name: home for home, names in _NAMES.items() for name in names.split()}
)
