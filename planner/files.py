"""Plan files: versioned JSON that can be read without this package.

The schema is the pydantic model ``PlanFile`` (``opposable schema plan`` prints it as JSON Schema).
Field names carry units and frames; a pose is a position in metres and a quaternion w, x, y, z.
Reading checks the format, the version and the hand's digest, rebuilds the task, and recomputes
contacts, forces and quality from the joints: a file whose contacts are not those of its joints is
refused.
"""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Sequence
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import (
    BaseModel,
    Field,
    SerializerFunctionWrapHandler,
    ValidationError,
    model_serializer,
)

from planner.catalog import hand_names
from planner.contacts import ContactModel, ContactSet
from planner.errors import FileFormatError, TaskError
from planner.hand import Hand
from planner.judge import judge_grasp
from planner.objects import GraspObject
from planner.plan import GraspPlan, JointTrajectory, SolveRecord
from planner.regions import Region, TouchRegion
from planner.schema import StrictData, faults_of
from planner.shapes import shape_from_dict, shape_to_dict
from planner.spatial import SE3, FloatArray, pose_from_wxyz, pose_to_wxyz
from planner.synthesis.carried import ArmPath
from planner.synthesis.pregrasp import Approach
from planner.task import GraspTask, Obstacle

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

PLAN_VERSION = 1

CONTACT_TOL = 1e-4
"""How far stored contacts (m), normals (-), forces (N) and torques (N m) may be from those
recomputed from the stored joints: what rounding leaves after a quadratic programme."""

QUATERNION_TOL = 1e-3
"""How far (-) the length of a quaternion in a file may be from 1: figures typed with few digits."""

LARGEST = 1e6
"""Largest number, either sign, in SI units: no grasp has a larger one, and its square is finite."""

Finite = Annotated[float, Field(allow_inf_nan=False, ge=-LARGEST, le=LARGEST)]
NotNegative = Annotated[float, Field(allow_inf_nan=False, ge=0, le=LARGEST)]
Vector3 = tuple[Finite, Finite, Finite]
Vector4 = tuple[Finite, Finite, Finite, Finite]


class PoseData(StrictData):
    """A pose: position (m) and unit quaternion w, x, y, z."""

    position_m: Vector3
    quaternion_wxyz: Vector4

    @classmethod
    def of(cls, pose: SE3) -> PoseData:
        """From a pose."""
        position, quaternion = pose_to_wxyz(pose)
        return cls(position_m=tuple(position), quaternion_wxyz=tuple(quaternion))

    def pose(self) -> SE3:
        """As a pose."""
        if not abs(math.hypot(*self.quaternion_wxyz) - 1.0) <= QUATERNION_TOL:
            raise FileFormatError(f"the quaternion {self.quaternion_wxyz} is not of unit length")
        return pose_from_wxyz(np.array(self.position_m), np.array(self.quaternion_wxyz))


class HandData(StrictData):
    """Which hand: its name, where it was described, and the digest of its files."""

    name: str
    description_path: str
    sha256: str


class RegionData(StrictData):
    """A box in the object's frame; null where it has no bound."""

    name: str
    lower_m: tuple[Finite | None, Finite | None, Finite | None]
    upper_m: tuple[Finite | None, Finite | None, Finite | None]

    @classmethod
    def of(cls, region: Region) -> RegionData:
        """From a region."""
        bounds = (
            tuple(v if math.isfinite(v) else None for v in corner)
            for corner in (region.lower, region.upper)
        )
        lower, upper = bounds
        return cls.model_validate({"name": region.name, "lower_m": lower, "upper_m": upper})

    def region(self) -> Region:
        """As a region."""
        x, y, z = (-math.inf if v is None else v for v in self.lower_m)
        a, b, c = (math.inf if v is None else v for v in self.upper_m)
        return Region(name=self.name, lower=(x, y, z), upper=(a, b, c))


class TouchData(StrictData):
    """Where the object may, must not, and must (by finger) be touched."""

    allowed: list[RegionData]
    forbidden: list[RegionData]
    required: dict[str, RegionData]

    @classmethod
    def of(cls, touch: TouchRegion | None) -> TouchData | None:
        """From regions; None for none."""
        if touch is None:
            return None
        return cls(
            allowed=[RegionData.of(r) for r in touch.allowed],
            forbidden=[RegionData.of(r) for r in touch.forbidden],
            required={f: RegionData.of(r) for f, r in touch.required.items()},
        )

    def touch(self) -> TouchRegion:
        """As regions."""
        return TouchRegion(
            allowed=tuple(r.region() for r in self.allowed),
            forbidden=tuple(r.region() for r in self.forbidden),
            required={f: r.region() for f, r in self.required.items()},
        )


class ObjectData(StrictData):
    """Which object: shape as its kind and sizes in metres (full extents, radii), and mass."""

    name: str
    shape: dict[str, str | Finite | list[Finite]]
    mass_kg: float = Field(gt=0, allow_inf_nan=False)
    touch: TouchData | None = None


class ObstacleData(StrictData):
    """A fixed box."""

    name: str
    size_m: Vector3
    T_world_obstacle: PoseData


class TaskData(StrictData):
    """The task of a plan."""

    hand: HandData
    object: ObjectData
    T_world_object: PoseData
    table_height_m: Finite | None
    obstacles: list[ObstacleData]
    gravity_m_s2: Vector3
    mu: Finite
    mu_torsion_m: Finite
    contact_model: ContactModel
    fingers: list[str]
    grip_force_N: Finite
    T_world_base_fixed: PoseData | None
    wrist_free: bool
    wrist_q_rad: list[Finite]


class ArmData(StrictData):
    """Paths of the arm that carries the hand: rows of its joints, rad (m for slides)."""

    joint_names: list[str]
    approach_q_rad: list[list[Finite]]
    lift_q_rad: list[list[Finite]]

    @classmethod
    def of(cls, plan: GraspPlan, path: ArmPath) -> ArmData:
        """From a plan."""
        hand = plan.task.hand
        return cls(
            joint_names=[hand.joint_names[k] for k in hand.arm_index],
            approach_q_rad=path.approach.tolist(),
            lift_q_rad=path.lift.tolist(),
        )

    def path(self, hand: Hand) -> ArmPath:
        """As paths.

        Raises:
            FileFormatError: They are of other joints, or rows differ in length.
        """
        names = [hand.joint_names[k] for k in hand.arm_index]
        rows = [*self.approach_q_rad, *self.lift_q_rad]
        if self.joint_names != names or any(len(row) != len(names) for row in rows):
            raise FileFormatError(f"the paths of the arm are not those of the joints {names}")
        return ArmPath(approach=np.array(self.approach_q_rad), lift=np.array(self.lift_q_rad))


class GraspData(StrictData):
    """The grasp itself; joints in the order of ``joint_names``; ``arm`` if the hand is on one."""

    T_world_base: PoseData
    T_world_base_start: PoseData
    T_world_palm: PoseData
    joint_names: list[str]
    q_rad: list[Finite]
    q_pregrasp_rad: list[Finite]
    opening_m: Finite
    arm: ArmData | None = None

    @model_serializer(mode="wrap")
    def _without_absent_arm(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """All fields; files of hands without an arm stay as they were before there were arms."""
        data: dict[str, Any] = handler(self)
        if self.arm is None:
            del data["arm"]
        return data


class ContactData(StrictData):
    """One planned contact, world frame; force on the object in the contact frame."""

    finger: str
    position_world_m: Vector3
    normal_into_object_world: Vector3
    tangent1_world: Vector3
    tangent2_world: Vector3
    model: ContactModel
    mu: Finite
    mu_torsion_m: Finite
    force_normal_N: Finite
    force_tangent1_N: Finite
    force_tangent2_N: Finite
    torque_normal_N_m: Finite


class RecordData(StrictData):
    """Where the plan comes from."""

    seed: int
    attempt: int
    attempts: int
    iterations: int
    status: str
    cpu_s: Finite
    build_s: Finite


class PlanFile(StrictData):
    """A grasp plan as JSON."""

    format: Literal["opposable-plan"] = "opposable-plan"
    version: Literal[1] = 1
    written_by: str
    task: TaskData
    grasp: GraspData
    contacts: list[ContactData]
    joint_torques_N_m: list[Finite]
    quality: dict[str, Any]
    pad_gaps_m: list[Finite]
    smallest_clearances_m: dict[str, Finite]
    record: RecordData


def plan_to_dict(plan: GraspPlan) -> dict[str, Any]:
    """A plan as plain data that follows ``PlanFile``."""
    task, hand = plan.task, plan.task.hand
    if hand.reference is None:
        raise TaskError(
            f"{hand.name} was made in Python, so no file can name it; write its model and its "
            "description to files and load it from there"
        )
    path = "" if hand.reference in hand_names() else hand.reference
    data = PlanFile(
        written_by=f"opposable {version('opposable')}",
        task=TaskData(
            hand=HandData(name=hand.name, description_path=path, sha256=hand.digest),
            object=ObjectData(
                name=task.object.name,
                shape=shape_to_dict(task.object.shape),
                mass_kg=task.object.mass,
                touch=TouchData.of(task.object.touch),
            ),
            T_world_object=PoseData.of(task.T_world_object),
            table_height_m=task.table_height,
            obstacles=[
                ObstacleData(
                    name=o.name,
                    size_m=tuple(o.size),
                    T_world_obstacle=PoseData.of(o.T_world_obstacle),
                )
                for o in task.obstacles
            ],
            gravity_m_s2=tuple(task.gravity),
            mu=task.mu,
            mu_torsion_m=task.mu_torsion,
            contact_model=task.contact_model,
            fingers=list(task.finger_names),
            grip_force_N=task.grip_force,
            T_world_base_fixed=None
            if task.T_world_base is None
            else PoseData.of(task.T_world_base),
            wrist_free=task.wrist_free,
            wrist_q_rad=list(task.wrist_q),
        ),
        grasp=GraspData(
            T_world_base=PoseData.of(plan.T_world_base),
            T_world_base_start=PoseData.of(plan.T_world_base_start),
            T_world_palm=PoseData.of(plan.T_world_palm),
            joint_names=list(hand.joint_names),
            q_rad=list(plan.q),
            q_pregrasp_rad=list(plan.q_pregrasp),
            opening_m=plan.opening,
            arm=None if plan.arm is None else ArmData.of(plan, plan.arm),
        ),
        contacts=[_contact_data(plan, i) for i in range(len(plan.contacts))],
        joint_torques_N_m=list(plan.forces.joint_torques),
        quality=plan.quality.to_dict(),
        pad_gaps_m=list(plan.verification.pad_gaps),
        smallest_clearances_m={
            f"{c.first} - {c.second}": c.distance for c in plan.verification.closest
        },
        record=RecordData(**{k: getattr(plan.record, k) for k in RecordData.model_fields}),
    )
    return data.model_dump(mode="json")


def _contact_data(plan: GraspPlan, i: int) -> ContactData:
    contact = plan.contacts[i]
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


def write_json(data: dict[str, Any], path: Path | str) -> None:
    """Write JSON whole or not at all: a file beside it is renamed into place.

    Raises:
        FileFormatError: The folder does not exist or cannot be written.
    """
    path = Path(path)
    partial = path.with_name(path.name + ".part")
    try:
        partial.write_text(json.dumps(data, indent=1, allow_nan=False) + "\n", encoding="utf-8")
        partial.replace(path)
    except OSError as error:
        with suppress(OSError):
            partial.unlink()
        raise FileFormatError(f"cannot write {path}: {error.strerror}") from error


def write_plan(plan: GraspPlan, path: Path | str) -> None:
    """Write a plan file."""
    write_json(plan_to_dict(plan), path)


def write_trajectory(trajectory: JointTrajectory, path: Path | str) -> None:
    """Write a trajectory as CSV: time, phase, one column per joint (rad or m), pose of the base.

    Raises:
        FileFormatError: The folder does not exist or cannot be written.
    """
    base = ["x_m", "y_m", "z_m", "qw", "qx", "qy", "qz"]
    header = ["time_s", "phase", *trajectory.joint_names, *(f"base_{name}" for name in base)]
    rows = [
        [f"{t:.6f}", phase, *(f"{v:.9f}" for v in np.concatenate([q, *pose_to_wxyz(pose)]))]
        for t, phase, q, pose in zip(
            trajectory.times,
            trajectory.phases,
            trajectory.positions,
            trajectory.T_world_base,
            strict=True,
        )
    ]
    try:
        with Path(path).open("w", newline="", encoding="utf-8") as file:
            csv.writer(file).writerows([header, *rows])
    except OSError as error:
        raise FileFormatError(f"cannot write {path}: {error.strerror}") from error


def read_json(path: Path | str, what: str) -> dict[str, Any]:
    """Read a JSON object.

    Raises:
        FileFormatError: Missing, unreadable or not a JSON object.
    """
    path = Path(path)
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise FileFormatError(f"cannot read {what} {path}: {error.strerror}") from error
    except (ValueError, RecursionError) as error:  # not JSON, not text, too long or too deep
        raise FileFormatError(f"{path} is damaged or not JSON: {error}") from error
    if not isinstance(data, dict):
        raise FileFormatError(f"{path} holds a {type(data).__name__}; {what} is a JSON object")
    return data


def read_plan(path: Path | str, *, hand: Hand | None = None) -> GraspPlan:
    """Read a plan file and check it.

    Args:
        path: The file.
        hand: The hand to use; the one that the file names if None.

    Raises:
        FileFormatError: Damaged, of another version, or for another hand.
        PlannerError: The hand or object cannot be loaded.
    """
    data = read_json(path, "plan file")
    if data.get("format") != "opposable-plan":
        raise FileFormatError(f"{path} is not a plan file: its format is {data.get('format')!r}")
    if data.get("version") != PLAN_VERSION:
        raise FileFormatError(
            f"{path} has plan version {data.get('version')!r}; this Opposable reads version "
            f"{PLAN_VERSION}; plan again"
        )
    try:
        file = PlanFile.model_validate(data)
    except ValidationError as error:
        raise FileFormatError(f"{path} is damaged: {faults_of(error)}") from error
    given = file.task.hand
    hand = hand or Hand.load(given.description_path or given.name)
    if hand.digest != given.sha256:
        raise FileFormatError(
            f"{path} was planned for a different {given.name!r} than "
            f"{hand.reference or hand.name}: the files have changed since; plan again, or give the "
            "hand that it was planned for"
        )
    if list(hand.joint_names) != file.grasp.joint_names:
        raise FileFormatError(f"{path} has other joints than {hand.name}; it is damaged")
    return _rebuild(file, hand, Path(path))


def _rebuild(file: PlanFile, hand: Hand, path: Path) -> GraspPlan:
    task = _task(file.task, hand)
    grasp = file.grasp
    approach = Approach(
        q=hand.checked_q(grasp.q_pregrasp_rad, "q_pregrasp_rad"),
        opening=grasp.opening_m,
        T_world_base_start=grasp.T_world_base_start.pose(),
        arm=None if grasp.arm is None else grasp.arm.path(hand),
    )
    plan = judge_grasp(
        task,
        grasp.T_world_base.pose(),
        hand.checked_q(grasp.q_rad, "q_rad"),
        record=SolveRecord(**file.record.model_dump()),
        approach=approach,
    )
    if isinstance(plan, str):
        raise FileFormatError(f"{path} holds a grasp that fails its checks: {plan}")
    again = PlanFile.model_validate(plan_to_dict(plan))
    if [c.finger for c in file.contacts] != [c.finger for c in again.contacts]:
        raise FileFormatError(f"{path}: its contacts are not those of its fingers; it is damaged")
    for what, stored, true, tolerance in (
        ("contacts", _numbers(file.contacts), _numbers(again.contacts), CONTACT_TOL),
        ("torques", file.joint_torques_N_m, again.joint_torques_N_m, CONTACT_TOL),
        ("palm pose", _numbers([grasp.T_world_palm]), _numbers([again.grasp.T_world_palm]), 1e-6),
    ):
        if np.shape(stored) != np.shape(true) or not np.allclose(
            stored, true, atol=tolerance, rtol=CONTACT_TOL
        ):
            raise FileFormatError(f"{path}: its {what} are not those of its joints; it is damaged")
    return plan


def _numbers(items: Sequence[BaseModel]) -> FloatArray:
    """All numbers in some data, in order."""
    flat: list[float] = []
    for item in items:
        for value in item.model_dump().values():
            if isinstance(value, tuple):
                flat += value
            elif isinstance(value, float):
                flat.append(value)
    return np.array(flat)


def _task(data: TaskData, hand: Hand) -> GraspTask:
    return GraspTask(
        hand=hand,
        object=GraspObject(
            name=data.object.name,
            shape=shape_from_dict(data.object.shape),
            mass=data.object.mass_kg,
            touch=None if data.object.touch is None else data.object.touch.touch(),
        ),
        T_world_object=data.T_world_object.pose(),
        table_height=data.table_height_m,
        obstacles=tuple(
            Obstacle(
                name=o.name, size=np.array(o.size_m), T_world_obstacle=o.T_world_obstacle.pose()
            )
            for o in data.obstacles
        ),
        gravity=np.array(data.gravity_m_s2),
        mu=data.mu,
        mu_torsion=data.mu_torsion_m,
        contact_model=data.contact_model,
        finger_names=tuple(data.fingers),
        grip_force=data.grip_force_N,
        T_world_base=None if data.T_world_base_fixed is None else data.T_world_base_fixed.pose(),
        wrist_free=data.wrist_free,
        wrist_q=np.array(data.wrist_q_rad),
    )


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
