"""Files that people and other programmes read: plans, contacts, trajectories.

What is public here is loaded when it is first used: a plan needs no movement.
"""

from typing import TYPE_CHECKING

from planner.system.lazy_names import lazy_names

if TYPE_CHECKING:
    from planner.files.contacts_file import ContactsFile, read_contacts
    from planner.files.data import PLAN_VERSION, PlanFile, TaskData
    from planner.files.gaits import GaitFile, read_gait, write_gait
    from planner.files.json_csv import read_json, write_json, write_trajectory
    from planner.files.manipulations import (
        ManipulationFile,
        given_manipulation,
        read_manipulation,
        write_manipulation,
    )
    from planner.files.motions import MotionFile, read_motion, write_motion
    from planner.files.plan_folder import format_told, plan_files
    from planner.files.plans import (
        given_plan,
        plan_from_dict,
        plan_to_dict,
        pose_of_plan,
        read_plan,
        write_plan,
    )
    from planner.files.tasks import task_data, task_from_data
    from planner.files.whole import plain_name, whole_file

__all__ = [
    "PLAN_VERSION",
    "ContactsFile",
    "GaitFile",
    "ManipulationFile",
    "MotionFile",
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
    "read_plan",
    "task_data",
    "task_from_data",
    "whole_file",
    "write_gait",
    "write_json",
    "write_manipulation",
    "write_motion",
    "write_plan",
    "write_trajectory",
]

_NAMES = {
    "planner.files.contacts_file": "ContactsFile read_contacts",
    "planner.files.data": "PLAN_VERSION PlanFile TaskData",
    "planner.files.gaits": "GaitFile read_gait write_gait",
    "planner.files.json_csv": "read_json write_json write_trajectory",
    "planner.files.manipulations": (
        "ManipulationFile given_manipulation read_manipulation write_manipulation"
    ),
    "planner.files.motions": "MotionFile read_motion write_motion",
    "planner.files.plan_folder": "format_told plan_files",
    "planner.files.plans": (
        "given_plan plan_from_dict plan_to_dict pose_of_plan read_plan write_plan"
    ),
    "planner.files.tasks": "task_data task_from_data",
    "planner.files.whole": "plain_name whole_file",
}
"""Module -> the names that it defines."""

__getattr__, __dir__ = lazy_names(
    __name__, {name: home for home, names in _NAMES.items() for name in names.split()}
)
