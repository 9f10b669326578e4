"""Plan files: versioned JSON that can be read without this package.

The schema is the pydantic model ``PlanFile``; ``opposable export --schema plan`` prints it as JSON
Schema. Reading checks the format, the version and the hand's digest, rebuilds the task, and
recomputes contacts, forces and quality from the joints: a file that claims others is refused.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel

from planner.approach.pregrasp import Approach
from planner.contacts import Contact, ContactSet
from planner.errors import FileFormatError, TaskError, shown
from planner.failure import Failure
from planner.files.claims import check_clearances, check_quality
from planner.files.data import (
    ArmData,
    ContactData,
    GraspData,
    PlanFile,
    PoseData,
    RecordData,
)
from planner.files.json_csv import checked_file, read_json, write_json
from planner.files.tasks import task_data, task_from_data
from planner.hand_loading import load_hand
from planner.hands.hand import Hand
from planner.plan import GraspPlan
from planner.spatial import SE3, FloatArray
from planner.task import GraspTask
from planner.verification.grasp import verify_grasp
from planner.version import written_by

CONTACT_TOL = 1e-4
"""How far stored contacts (m), normals (-), forces (N) and torques (N m) may be from those
recomputed from the stored joints: what rounding leaves after a quadratic programme."""


def plan_to_dict(plan: GraspPlan) -> dict[str, Any]:
    """A plan as plain data that follows ``PlanFile``."""
    hand = plan.task.hand
    data = PlanFile(
        version=1 if plan.record.best is None else 2,
        written_by=written_by(),
        task=task_data(plan.task),
        grasp=GraspData(
            T_world_base=PoseData.of(plan.T_world_base),
            T_world_base_start=PoseData.of(plan.T_world_base_start),
            T_world_palm=PoseData.of(plan.T_world_palm),
            joint_names=list(hand.joint_names),
            q_rad=list(plan.q),
            q_pregrasp_rad=list(plan.q_pregrasp),
            opening_m=plan.pregrasp_distance,
            arm=None if plan.arm is None else ArmData.of(plan, plan.arm),
        ),
        contacts=contact_data(plan.contacts),
        joint_torques_N_m=list(plan.forces.joint_torques),
        quality=plan.quality.to_dict(),
        pad_gaps_m=list(plan.verification.pad_gaps),
        smallest_clearances_m={
            f"{c.first} - {c.second}": c.distance for c in plan.verification.closest
        },
        record=RecordData.of(plan.record),
    )
    return data.model_dump(mode="json")


def contact_data(contacts: ContactSet) -> list[ContactData]:
    """Contacts in the world as data."""
    return [_one_contact(contacts[i]) for i in range(len(contacts))]


def _one_contact(contact: Contact) -> ContactData:
    normal, tangent1, tangent2 = (tuple(column) for column in contact.frame.T)
    fn, ft1, ft2, torque = (float(v) for v in contact.force)
    return ContactData(
        finger=contact.finger,
        position_world_m=tuple(contact.position),
        normal_into_object_world=normal,
        tangent1_world=tangent1,
        tangent2_world=tangent2,
        model=contact.model,
        mu=contact.mu,
        mu_torsion_m=contact.mu_torsion,
        force_normal_N=fn,
        force_tangent1_N=ft1,
        force_tangent2_N=ft2,
        torque_normal_N_m=torque,
    )


def write_plan(plan: GraspPlan, path: Path | str) -> None:
    """Write a plan file."""
    write_json(plan_to_dict(plan), path)


def read_plan(path: Path | str, *, hand: Hand | None = None) -> GraspPlan:
    """Read a plan file and check it.

    Args:
        path: The file.
        hand: The hand to use; the one that the file names if None.

    Raises:
        FileFormatError: Damaged, of another version, or for another hand.
        PlannerError: The hand or object cannot be loaded.
    """
    return plan_from_dict(read_json(path, "plan file"), str(path), hand=hand)


def given_plan(given: GraspPlan | Path | str) -> GraspPlan:
    """A plan as it is, or read from its file.

    Raises:
        FileFormatError: As ``read_plan``.
        TaskError: Neither a plan of a grasp nor a path.
    """
    if isinstance(given, str | Path):
        return read_plan(given)
    if not isinstance(given, GraspPlan):
        raise TaskError(
            f"{shown(given)} is a {type(given).__name__}; give the plan of a grasp, as plan_grasp "
            "returns it, or the path of its file"
        )
    return given


def plan_from_dict(data: dict[str, Any], source: str, *, hand: Hand | None = None) -> GraspPlan:
    """The plan that plain data hold, checked like a file.

    Args:
        data: What ``plan_to_dict`` gave.
        source: What errors call it, as the path of a file.
        hand: The hand to use; the one that the data name if None.

    Raises:
        FileFormatError: Damaged, of another version, or for another hand.
        PlannerError: The hand or object cannot be loaded.
    """
    file, hand = _with_hand(data, source, hand)
    return _rebuild(file, hand, source)


def pose_of_plan(path: Path | str) -> tuple[GraspTask, SE3, FloatArray]:
    """Task, base pose (world) and joints (nq,) of a plan file, of which nothing is verified.

    For ``planner.refine``: the pose may have been changed by hand, and need be no grasp.

    Raises:
        FileFormatError: Missing, damaged, of another version, or for another hand.
        PlannerError: The hand or object cannot be loaded.
    """
    file, hand = _with_hand(read_json(path, "plan"), str(path), None)
    q = np.array(file.grasp.q_rad, dtype=np.float64)
    return task_from_data(file.task, hand), file.grasp.T_world_base.pose(), q


def _with_hand(data: dict[str, Any], source: str, hand: Hand | None) -> tuple[PlanFile, Hand]:
    """A plan's data after the checks of its form, and the hand that they are for."""
    file = checked_file(PlanFile, data, source)
    given = file.task.hand
    hand = hand or load_hand(given.description_path or given.name, download=False)
    hand = hand.rolling if given.rolling else hand
    if hand.digest != given.sha256:
        raise FileFormatError(
            f"{source} was planned for a different {given.name!r} than "
            f"{hand.reference or hand.name}: the files have changed since; plan again, or give the "
            "hand that it was planned for"
        )
    if list(hand.joint_names) != file.grasp.joint_names:
        raise FileFormatError(f"{source} has other joints than {hand.name}; it is damaged")
    return file, hand


def _rebuild(file: PlanFile, hand: Hand, source: str) -> GraspPlan:
    task = task_from_data(file.task, hand)
    grasp = file.grasp
    approach = Approach(
        q=hand.checked_q(grasp.q_pregrasp_rad, "q_pregrasp_rad"),
        pregrasp_distance=grasp.opening_m,
        T_world_base_start=grasp.T_world_base_start.pose(),
        arm=None if grasp.arm is None else grasp.arm.path(hand),
    )
    plan = verify_grasp(
        task,
        grasp.T_world_base.pose(),
        hand.checked_q(grasp.q_rad, "q_rad"),
        record=file.record.record(),
        approach=approach,
    )
    if isinstance(plan, Failure):
        raise FileFormatError(f"{source} holds a grasp that fails its checks: {plan}")
    again = PlanFile.model_validate(plan_to_dict(plan))
    if [c.finger for c in file.contacts] != [c.finger for c in again.contacts]:
        raise FileFormatError(f"{source}: its contacts are not those of its fingers; it is damaged")
    for what, stored, true, tolerance in (
        ("contacts", numbers_of(file.contacts), numbers_of(again.contacts), CONTACT_TOL),
        ("torques", file.joint_torques_N_m, again.joint_torques_N_m, CONTACT_TOL),
        (
            "palm pose",
            numbers_of([grasp.T_world_palm]),
            numbers_of([again.grasp.T_world_palm]),
            1e-6,
        ),
    ):
        if np.shape(stored) != np.shape(true) or not np.allclose(
            stored, true, atol=tolerance, rtol=CONTACT_TOL
        ):
            raise FileFormatError(
                f"{source}: its {what} are not those of its joints; it is damaged"
            )
    check_quality(file.quality, again.quality, plan.contacts, source)
    check_clearances(
        file.smallest_clearances_m, again.smallest_clearances_m, "smallest_clearances_m", source
    )
    fingers = [c.finger for c in again.contacts]
    if len(file.pad_gaps_m) != len(fingers):
        raise FileFormatError(f"{source}: its pad_gaps_m are not one per finger; it is damaged")
    claimed, real = (dict(zip(fingers, d.pad_gaps_m, strict=True)) for d in (file, again))
    check_clearances(claimed, real, "pad_gaps_m", source)
    return plan


def numbers_of(items: Sequence[BaseModel]) -> FloatArray:
    """All numbers in some data, in order."""
    flat: list[float] = []
    for item in items:
        for value in item.model_dump().values():
            if isinstance(value, tuple):
                flat += value
            elif isinstance(value, float):
                flat.append(value)
    return np.array(flat)
