"""Plan files: written, read, their figures checked; and contacts to be analysed.

Plan files: versioned JSON that can be read without this package.

The schema is the pydantic model ``PlanFile``; ``opposable export --schema plan`` prints it as JSON
Schema. Reading checks the format, the version and the hand's digest, rebuilds the task, and
recomputes contacts, forces and quality from the joints: a file that claims others is refused.

Check of the figures in a plan file against its grasp.

Readers of the JSON without this package rely on its quality, gaps and clearances. They are computed
again from the joints, and a file with other figures is refused. Figures that are not unique are
checked by their defining property: an interval encloses the true value as tightly as ours, the
weights of closure balance, and no wrench is harder to balance than the weakest. Texts are not
compared.

Contacts to be analysed: a list that a user typed in, or those of a plan file.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, Field, ValidationError

from planner.collision.pregrasp import Approach
from planner.contacts import Contact, ContactModel, ContactSet
from planner.errors import FileFormatError, TaskError, shown
from planner.failure import Failure
from planner.files.data import (
    ArmData,
    ContactData,
    GraspData,
    HandData,
    PlanFile,
    PoseData,
    RecordData,
    task_data,
    task_from_data,
)
from planner.files.disk import MOVEMENT_FORMATS, checked_file, read_json, write_json
from planner.hand_loading import load_hand
from planner.hands.hand import Hand
from planner.plan import GraspPlan
from planner.quality import primitive_wrenches
from planner.schema import LARGEST, NotNegative, StrictData, Vector3, faults_of
from planner.spatial import SE3, FloatArray
from planner.system.package import written_by
from planner.task import GraspTask
from planner.verification import verify_grasp

QUALITY_REL_TOL = 1e-3
"""How far stored figures may be from those computed again, as a share of the larger (-): contacts
recomputed on another machine differ by rounding, 1e-9 and less."""

QUALITY_ABS_TOL = 1e-6
"""The same in their own unit, for figures near zero."""

CLEARANCE_TOL = 1e-4
"""The same for gaps and clearances, m: as for the positions of contacts."""

LARGEST_FIGURE = 1e300
"""Largest figure of a grasp, in any unit."""

INTERVALS = ("epsilon_round", "epsilon_linf")
WORDS = ("reason",)
CERTIFICATES = ("weights", "weakest_wrench_n_nm")


def check_quality(
    claimed: Mapping[str, Any], true: Mapping[str, Any], contacts: ContactSet, source: str
) -> None:
    """Refuse a claimed quality that the contacts do not have.

    Args:
        claimed: What the file says, as ``QualityReport.to_dict`` writes it.
        true: The same from the contacts.
        contacts: The contacts of the plan, world axes.
        source: What errors call the file.

    Raises:
        FileFormatError: A figure is missing, unknown, or another one.
    """
    for name, value in _pairs(claimed, true, "quality", source):
        known = true[name]
        if name == "closure":
            if not isinstance(value, Mapping):
                raise _other(source, f"quality.{name}")
            for part, claim in _pairs(value, known, "quality.closure", source):
                if part not in (*WORDS, *CERTIFICATES) and not _agree(claim, known[part]):
                    raise _other(source, f"quality.closure.{part}", claim, known[part])
        elif name in INTERVALS:
            if not _encloses(value, known):
                raise _other(source, f"quality.{name}", value, known)
        elif name not in CERTIFICATES and not _agree(value, known):
            raise _other(source, f"quality.{name}", value, known)
    length = true["length_m"]
    wrenches = primitive_wrenches(contacts, true["edges"], length=length)
    if not _balance(claimed["closure"]["weights"], true["closure"], wrenches):
        raise _other(source, "quality.closure.weights")
    weakest = _numbers(claimed["weakest_wrench_n_nm"], 6)
    if weakest is not None:
        unit = weakest / np.repeat([1.0, length], 3)
        reach = float((-unit @ wrenches).max(initial=0.0))
        is_unit = _agree(float(np.linalg.norm(unit)), 1.0)
        if is_unit and reach <= true["epsilon"] * (1 + QUALITY_REL_TOL) + QUALITY_ABS_TOL:
            return
    raise _other(source, "quality.weakest_wrench_n_nm")


def check_clearances(
    claimed: Mapping[str, float], true: Mapping[str, float], what: str, source: str
) -> None:
    """Refuse claimed distances (m), by what they are between, that are not those of the joints.

    Two pairs that are equally far apart may stand for each other at the end of the list.

    Raises:
        FileFormatError: There are others.
    """
    last = max(true.values(), default=0.0)
    if len(claimed) != len(true):
        raise _other(source, what)
    for pair, distance in claimed.items():
        if abs(distance - true.get(pair, last)) > CLEARANCE_TOL:
            raise _other(source, f"{what}, {pair!r}", distance, true.get(pair))


def _pairs(claimed: Mapping[str, Any], true: Mapping[str, Any], what: str, source: str) -> Any:
    if set(claimed) != set(true):
        raise _other(source, f"list of figures in {what}", sorted(claimed), sorted(true))
    return claimed.items()


def _other(source: str, what: str, claimed: Any = None, true: Any = None) -> FileFormatError:
    compared = ""
    if claimed is not None or true is not None:
        compared = f" ({shown(claimed, 140)}, recomputed {shown(true, 140)})"
    return FileFormatError(
        f"{source}: its {what} is not that of its joints{compared}; it is damaged, or was "
        "changed: plan again, or write the plan again where it was made"
    )


def _numbers(value: Any, n: int) -> Any:
    """So many finite numbers as an array, else None."""
    good = isinstance(value, list) and len(value) == n
    if not good or not all(_is_figure(x) for x in value):
        return None
    return np.array(value, dtype=np.float64)


def _is_figure(value: Any) -> bool:
    """Whether it is a finite number; a whole one may have more digits than a float can hold."""
    is_number = isinstance(value, float | int) and not isinstance(value, bool)
    return is_number and abs(value) <= LARGEST_FIGURE


def _agree(claimed: Any, true: Any) -> bool:
    """Whether two figures are the same but for rounding; None and lists only if they are equal."""
    if isinstance(true, bool) or not isinstance(true, float | int):
        return type(claimed) is type(true) and bool(claimed == true)
    if not _is_figure(claimed):
        return False
    return bool(np.isclose(claimed, true, rtol=QUALITY_REL_TOL, atol=QUALITY_ABS_TOL))


def _encloses(claimed: Any, true: Any) -> bool:
    """Whether an interval meets the true one and its ends are no farther than that one is wide."""
    ends = _numbers(claimed, 2)
    if ends is None or ends[0] > ends[1]:
        return False
    slack = true[1] - true[0] + QUALITY_REL_TOL * abs(true[1]) + QUALITY_ABS_TOL
    return bool(
        np.abs(ends - true).max() <= slack
        and ends[0] <= true[1] + QUALITY_ABS_TOL
        and true[0] <= ends[1] + QUALITY_ABS_TOL
    )


def _balance(claimed: Any, closure: Mapping[str, Any], wrenches: Any) -> bool:
    """Whether weights prove closure: of sum 1, none below the min-weight, without resultant."""
    if closure["weights"] is None:
        return claimed is None
    weights = _numbers(claimed, wrenches.shape[1])
    if weights is None or not _agree(float(weights.sum()), 1.0):
        return False
    least = closure["min_weight"] * (1 - QUALITY_REL_TOL) - QUALITY_ABS_TOL
    return bool(weights.min() >= least and np.abs(wrenches @ weights).max() <= BALANCE_TOL)


BALANCE_TOL = 1e-6
"""Largest resultant of the weights of closure per newton of normal force (-)."""


CONTACT_TOL = 1e-4
"""How far stored contacts (m), normals (-), forces (N) and torques (N m) may be from those
recomputed from the stored joints: what rounding leaves after a quadratic programme."""


def _version_of(plan: GraspPlan) -> Literal[1, 2, 3, 4]:
    """The first version that has what a plan has."""
    if plan.task.joint_error:
        return 4
    if plan.task.needed:
        return 3
    return 1 if plan.record.best is None else 2


def plan_to_dict(plan: GraspPlan) -> dict[str, Any]:
    """A plan as plain data that follows ``PlanFile``."""
    hand = plan.task.hand
    data = PlanFile(
        version=_version_of(plan),
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
        data: What ``plan_to_dict`` gave; of the use of a tool its grasp is taken.
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

    For ``planner.search.refine``: the pose may have been changed by hand, and need be no grasp.

    Raises:
        FileFormatError: Missing, damaged, of another version, or for another hand.
        PlannerError: The hand or object cannot be loaded.
    """
    file, hand = _with_hand(read_json(path, "plan"), str(path), None)
    q = np.array(file.grasp.q_rad, dtype=np.float64)
    return task_from_data(file.task, hand), file.grasp.T_world_base.pose(), q


def _with_hand(data: dict[str, Any], source: str, hand: Hand | None) -> tuple[PlanFile, Hand]:
    """A plan's data after the checks of its form, and the hand that they are for."""
    if data.get("format") == MOVEMENT_FORMATS[0] and data.get("tool_use"):
        data = data["grasp"]
    file = checked_file(PlanFile, data, source)
    hand = given_hand(file.task.hand, source, hand)
    if list(hand.joint_names) != file.grasp.joint_names:
        raise FileFormatError(f"{source} has other joints than {hand.name}; it is damaged")
    return file, hand


def given_hand(given: HandData, source: str, hand: Hand | None = None) -> Hand:
    """The hand that a file names, or one that is to be the same.

    Raises:
        FileFormatError: It is another one.
        PlannerError: It cannot be loaded.
    """
    hand = hand or load_hand(given.description_path or given.name, download=False)
    hand = hand.rolling if given.rolling else hand
    if hand.digest != given.sha256:
        raise FileFormatError(
            f"{source} was planned for a different {given.name!r} than "
            f"{hand.reference or hand.name}: the files have changed since; plan again, or give the "
            "hand that it was planned for"
        )
    return hand


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
    if str(data.get("format")).startswith("opposable-"):  # of ours only a plan has contacts
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
