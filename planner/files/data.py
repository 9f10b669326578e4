"""Schema of plan files, as pydantic models.

Field names carry units and frames; a pose is a position in metres and a quaternion w, x, y, z.

A task as data and back: part of every plan file and of every batch manifest.
"""

from __future__ import annotations

import math
from typing import Any, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, SerializerFunctionWrapHandler, model_serializer, model_validator

from planner.collision.arm_path import ArmPath
from planner.contacts import ContactModel
from planner.errors import FileFormatError, TaskError
from planner.hands.catalog import hand_names
from planner.hands.hand import Hand
from planner.objects import GraspObject, NeededWrench, Region, TouchRegion
from planner.plan import BestOf, GraspPlan, SolveRecord
from planner.schema import Finite, StrictData, Vector3, Vector4
from planner.shapes import shape_from_dict, shape_to_dict
from planner.spatial import SE3, pose_from_wxyz, pose_to_wxyz
from planner.task import GraspTask, Obstacle

PLAN_VERSION = 1
"""Version of plan files that are written, where nothing asks for a later one (``PlanFile``)."""

QUATERNION_TOL = 1e-3
"""How far (-) the length of a quaternion in a file may be from 1: figures typed with few digits."""


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
    """Which hand: its name, where it was described, and the digest of its files.

    ``rolling``: whether contacts may be anywhere in the pads' rolling cones (``Hand.rolling``).
    """

    name: str
    description_path: str
    sha256: str
    rolling: bool = False


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

    @classmethod
    def of(cls, item: GraspObject) -> ObjectData:
        """From an object."""
        return cls(
            name=item.name,
            shape=shape_to_dict(item.shape),
            mass_kg=item.mass,
            touch=TouchData.of(item.touch),
        )

    def object(self) -> GraspObject:
        """As an object.

        Raises:
            ObjectError: Its mesh file is missing or was changed.
        """
        return GraspObject(
            name=self.name,
            shape=shape_from_dict(self.shape),
            mass=self.mass_kg,
            touch=None if self.touch is None else self.touch.touch(),
        )


class ObstacleData(StrictData):
    """A fixed box."""

    name: str
    size_m: Vector3
    T_world_obstacle: PoseData


class NeededData(StrictData):
    """A wrench that the hand must be able to produce, object frame, about the centre of mass."""

    name: str
    force_N: Vector3
    torque_N_m: Vector3


class NeededSetData(StrictData):
    """The wrenches that a grasp must be able to produce, and how many times each of them."""

    margin: Finite
    wrenches: list[NeededData] = Field(min_length=1)


class LaterData(StrictData):
    """Data with fields that older files have not: each is left out where it is None or False.

    ``later`` has their names, between spaces.
    """

    later: ClassVar[str]

    @model_serializer(mode="wrap")
    def _as_older_files(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        data: dict[str, Any] = handler(self)
        for name in self.later.split():
            if data[name] is None or data[name] is False:
                del data[name]
        return data


class TaskData(LaterData):
    """The task of a plan.

    ``needed`` where it needs wrenches, ``joint_error_rad`` where joints may be off.
    """

    later = "needed joint_error_rad"

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
    needed: NeededSetData | None = None
    joint_error_rad: Finite | None = None


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


class GraspData(LaterData):
    """The grasp itself; joints in the order of ``joint_names``; ``arm`` if the hand is on one."""

    later = "arm"

    T_world_base: PoseData
    T_world_base_start: PoseData
    T_world_palm: PoseData
    joint_names: list[str]
    q_rad: list[Finite]
    q_pregrasp_rad: list[Finite]
    opening_m: Finite
    arm: ArmData | None = None


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


class BestData(StrictData):
    """Of how many plans it is the best, and by what; none in the first plan found."""

    found: int
    metric: str
    value: Finite
    improving: bool


class RecordData(LaterData):
    """Where the plan comes from."""

    later = "best"

    seed: int
    attempt: int
    attempts: int
    iterations: int
    status: str
    cpu_s: Finite
    build_s: Finite
    objective: str = "epsilon"
    best: BestData | None = None

    @classmethod
    def of(cls, record: SolveRecord) -> RecordData:
        """From a plan's record."""
        return cls.model_validate(record, from_attributes=True)

    def record(self) -> SolveRecord:
        """The plan's record."""
        best = None if self.best is None else BestOf(**self.best.model_dump())
        return SolveRecord(**(self.model_dump() | {"best": best}))


class PlanFile(StrictData):
    """A grasp plan as JSON.

    Version 2 is the best of several plans, which version 1 has not; version 3 needs wrenches;
    version 4 was planned for joints that may be off.
    """

    format: Literal["opposable-plan"] = "opposable-plan"
    version: Literal[1, 2, 3, 4] = 1
    written_by: str
    task: TaskData
    grasp: GraspData
    contacts: list[ContactData]
    joint_torques_N_m: list[Finite]
    quality: dict[str, Any]
    pad_gaps_m: list[Finite]
    smallest_clearances_m: dict[str, Finite]
    record: RecordData

    @model_validator(mode="after")
    def _needs_of_version(self) -> Self:
        if (self.task.joint_error_rad is not None) != (self.version == 4):
            raise ValueError(
                f"version {self.version} with joint_error_rad; that is in version 4 alone"
                if self.version != 4
                else "version 4 without joint_error_rad; every file of version 4 has it"
            )
        if (self.task.needed is not None) != (self.version == 3) and self.version != 4:
            has = "no needed wrenches" if self.task.needed is None else "needed wrenches"
            raise ValueError(f"version {self.version} with {has}; those are in versions 3 and 4")
        return self


def task_data(task: GraspTask) -> TaskData:
    """A task as data; its fingers are those it has, none to be spared later.

    Raises:
        TaskError: The hand was made in Python, so that no file can name it.
    """
    hand = task.hand
    if hand.reference is None:
        raise TaskError(
            f"{hand.name} was made in Python, so no file can name it; write its model and its "
            "description to files and load it from there"
        )
    path = "" if hand.reference in hand_names() else hand.reference
    return TaskData(
        hand=HandData(
            name=hand.name, description_path=path, sha256=hand.digest, rolling=hand.rolls
        ),
        object=ObjectData.of(task.object),
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
        T_world_base_fixed=None if task.T_world_base is None else PoseData.of(task.T_world_base),
        wrist_free=task.wrist_free,
        wrist_q_rad=list(task.wrist_q),
        needed=_needed_data(task),
        joint_error_rad=task.joint_error or None,
    )


def _needed_data(task: GraspTask) -> NeededSetData | None:
    """The wrenches that a task needs; None for none."""
    if not task.needed:
        return None
    wrenches = [
        NeededData(name=one.name, force_N=one.force, torque_N_m=one.torque) for one in task.needed
    ]
    return NeededSetData(margin=task.needed_margin, wrenches=wrenches)


def task_from_data(data: TaskData, hand: Hand) -> GraspTask:
    """The task that ``task_data`` wrote, for its hand."""
    return GraspTask(
        hand=hand,
        object=data.object.object(),
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
        joint_error=data.joint_error_rad or 0.0,
        **_needed_of(data.needed),
    )


def _needed_of(data: NeededSetData | None) -> dict[str, Any]:
    """Fields of a task that tell what it needs; none where it needs nothing."""
    if data is None:
        return {}
    wrenches = tuple(
        NeededWrench(name=one.name, force=one.force_N, torque=one.torque_N_m)
        for one in data.wrenches
    )
    return {"needed": wrenches, "needed_margin": data.margin}
