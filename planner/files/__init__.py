"""Files that people and other programmes read: plans, contacts, trajectories."""

from planner.files.contacts_file import ContactsFile, read_contacts
from planner.files.data import PLAN_VERSION, PlanFile
from planner.files.json_csv import read_json, write_json, write_trajectory
from planner.files.plans import plan_to_dict, read_plan, write_plan

__all__ = [
    "PLAN_VERSION",
    "ContactsFile",
    "PlanFile",
    "plan_to_dict",
    "read_contacts",
    "read_json",
    "read_plan",
    "write_json",
    "write_plan",
    "write_trajectory",
]
