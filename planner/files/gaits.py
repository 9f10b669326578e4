"""Gait files: versioned JSON with the first stroke as a motion, and how fingers move on after it.

Later cycles are the first one with the object further along; a file holds the first. Nothing in it
is believed: the motion is judged again, orders and ways are searched again, and a file whose
relocations are not those of its stroke is refused.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field

from planner.errors import FileFormatError
from planner.failure import Failure
from planner.files.data import ContactData, Finite
from planner.files.json_csv import checked_file, read_json, write_json
from planner.files.motions import MotionFile, motion_from_dict, motion_to_dict
from planner.files.plans import CONTACT_TOL, contact_data, numbers_of
from planner.hands.hand import Hand
from planner.motion.gait import GaitPlan, Relocation
from planner.motion.gait.verify import GaitVerifier
from planner.schema import StrictData
from planner.version import written_by

MOST_CYCLES = 1000
"""Most cycles of a file: each is judged when it is read."""


class RelocationData(StrictData):
    """One finger that moves on after the first stroke; joints in the order of the grasp's."""

    finger: str
    q_rad: list[list[Finite]]
    contacts_held: list[ContactData]
    contacts_after: list[ContactData]
    normalised_min_weight: Finite


class GaitFile(StrictData):
    """A gait plan as JSON."""

    format: Literal["opposable-gait"] = "opposable-gait"
    version: Literal[1] = 1
    written_by: str
    cycles: int = Field(ge=1, le=MOST_CYCLES)
    stroke: MotionFile
    relocations: list[RelocationData]


def gait_to_dict(plan: GaitPlan) -> dict[str, Any]:
    """A gait as plain data that follows ``GaitFile``."""
    data = GaitFile(
        written_by=written_by(),
        cycles=plan.cycles,
        stroke=MotionFile.model_validate(motion_to_dict(plan.motion)),
        relocations=[_relocation(r) for r in plan.relocations if r.cycle == 0],
    )
    return data.model_dump(mode="json")


def _relocation(relocation: Relocation) -> RelocationData:
    return RelocationData(
        finger=relocation.finger,
        q_rad=relocation.postures.tolist(),
        contacts_held=contact_data(relocation.during),
        contacts_after=contact_data(relocation.after),
        normalised_min_weight=relocation.margin,
    )


def write_gait(plan: GaitPlan, path: Path | str) -> None:
    """Write a gait file."""
    write_json(gait_to_dict(plan), path)


def read_gait(path: Path | str, *, hand: Hand | None = None) -> GaitPlan:
    """Read a gait file and check it.

    The plan is as ``plan_gait`` gave it: print it, or go through its ``phases``, strokes and moves
    of one finger, with a controller of your own.

    Args:
        path: The file.
        hand: The hand to use; the one that the file names if None.

    Raises:
        FileFormatError: Damaged, of another version, or for another hand; or it does not hold.
        PlannerError: The hand or object cannot be loaded.
    """
    return gait_from_dict(read_json(path, "gait file"), str(path), hand=hand)


def gait_from_dict(data: dict[str, Any], source: str, *, hand: Hand | None = None) -> GaitPlan:
    """The gait that plain data hold, checked like a file.

    Args:
        data: What ``gait_to_dict`` gave.
        source: What errors call it, as the path of a file.
        hand: The hand to use; the one that the data name if None.

    Raises:
        FileFormatError: Damaged, of another version, or for another hand; or it does not hold.
        PlannerError: The hand or object cannot be loaded.
    """
    file = checked_file(GaitFile, data, source)
    stroke = motion_from_dict(data["stroke"], source, hand=hand)
    plan = GaitVerifier(stroke.grasp.task).verify(stroke, file.cycles)
    if isinstance(plan, Failure):
        raise FileFormatError(f"{source} holds a gait that fails its checks: {plan}")
    true = [_relocation(r) for r in plan.relocations if r.cycle == 0]
    if [r.finger for r in file.relocations] != [r.finger for r in true]:
        raise FileFormatError(f"{source}: its fingers move on in another order; it is damaged")
    for told, found in zip(file.relocations, true, strict=True):
        for what, a, b in (
            ("way", np.ravel(told.q_rad), np.ravel(found.q_rad)),
            ("contacts", numbers_of(told.contacts_held), numbers_of(found.contacts_held)),
            ("contacts", numbers_of(told.contacts_after), numbers_of(found.contacts_after)),
        ):
            if a.shape != b.shape or not np.allclose(a, b, atol=CONTACT_TOL, rtol=CONTACT_TOL):
                raise FileFormatError(
                    f"{source}: the {what} with {told.finger} away are not those of its stroke; it "
                    "is damaged"
                )
    return plan
