"""Contacts to be analysed: a list that a user typed in, or those of a plan file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pydantic import Field, ValidationError

from planner.contacts import ContactModel, ContactSet
from planner.errors import FileFormatError
from planner.files.data import LARGEST, NotNegative, Vector3
from planner.files.json_csv import read_json
from planner.files.plans import read_plan
from planner.schema import StrictData, faults_of


class ContactInput(StrictData):
    """One contact that a user typed in."""

    position_m: Vector3
    normal_into_object: Vector3
    model: ContactModel = "point"
    mu: NotNegative = 0.5
    mu_torsion_m: NotNegative = 0.0


class ContactsFile(StrictData):
    """A list of contacts to analyse.

    Attributes:
        contacts: The contacts, all in one frame.
        center_m: Centre of mass of the object in that frame.
        length_m: Characteristic length by which torques are divided; the largest distance of a
            contact from the centre if left out.
    """

    contacts: list[ContactInput] = Field(min_length=1)
    center_m: Vector3 = (0.0, 0.0, 0.0)
    length_m: float | None = Field(None, gt=0, le=LARGEST, allow_inf_nan=False)


def read_contacts(path: Path | str) -> tuple[ContactSet, float]:
    """Contacts and characteristic length (m) of a plan file or a contacts file (``ContactsFile``).

    Raises:
        FileFormatError: Neither.
        ContactError: A normal has no direction.
    """
    data = read_json(path, "plan or contacts file")
    if data.get("format") == "opposable-plan":
        plan = read_plan(path)
        return plan.contacts, plan.task.object.shape.bounding_radius
    try:
        file = ContactsFile.model_validate(data)
    except ValidationError as error:
        raise FileFormatError(
            f"{path} is neither a plan nor a list of contacts: {faults_of(error)}. "
            'A list of contacts is {"contacts": [{"position_m": [x, y, z], '
            '"normal_into_object": [x, y, z], "mu": 0.5}]}'
        ) from error
    contacts = ContactSet.from_arrays(
        [c.position_m for c in file.contacts],
        [c.normal_into_object for c in file.contacts],
        mu=[c.mu for c in file.contacts],
        mu_torsion=[c.mu_torsion_m for c in file.contacts],
        model=[c.model for c in file.contacts],
        center=file.center_m,
    )
    arms = np.linalg.norm(contacts.positions - contacts.center, axis=1)
    length = file.length_m or float(arms.max())
    if length <= 0:
        raise FileFormatError(f"{path}: every contact is at the centre of mass; give length_m")
    return contacts, length
