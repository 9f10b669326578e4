"""The task of a report out of the plan that it holds: hand, object and surroundings to be drawn."""

from __future__ import annotations

from typing import Any

from planner.errors import FileFormatError
from planner.files.data import PlanFile, task_from_data
from planner.files.json_csv import checked_file
from planner.hand_loading import load_hand
from planner.task import GraspTask


def plan_file(plan: dict[str, Any], source: str = "the report's plan") -> PlanFile:
    """A plan that a report holds, with its format checked but not its claims.

    Raises:
        FileFormatError: Damaged, or of another version.
    """
    return checked_file(PlanFile, plan, source)


def task_of_plan(file: PlanFile, source: str = "the report's plan") -> GraspTask:
    """The task of a plan, with its hand loaded.

    Raises:
        FileFormatError: The hand's files have changed since.
        PlannerError: The hand or the object cannot be loaded.
    """
    given = file.task.hand
    hand = load_hand(given.description_path or given.name, download=False)
    hand = hand.rolling if given.rolling else hand
    if hand.digest != given.sha256:
        raise FileFormatError(
            f"{source} is of another {given.name!r} than {hand.reference or hand.name}: the hand's "
            "files have changed since, so that the motion cannot be shown; run it again"
        )
    return task_from_data(file.task, hand)
