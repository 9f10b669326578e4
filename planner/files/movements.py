"""Motion files: versioned JSON with the grasp, the path, and the object and joints at every knot.

As with grasps, nothing in a file is believed: the hand's digest is checked, and grasp and knots are
judged again on the true geometry. A file whose contacts are not those of its joints is refused.

Gait files: versioned JSON with the first stroke as a motion, and how fingers move on after it.

Later cycles are the first one with the object further along; a file holds the first. Nothing in it
is believed: the motion is judged again, orders and ways are searched again, and a file whose
relocations are not those of its stroke is refused.

Manipulation files: versioned JSON with the motion or gait, and how the object is put down.

Nothing in a file is believed: motion or gait are judged again, and so is the way out. A target or a
reserve of torque that is not that of the motion is refused.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field

from planner.approach.pregrasp import Approach
from planner.errors import FileFormatError, TaskError, shown
from planner.failure import Failure
from planner.files.data import (
    ArmData,
    ContactData,
    Finite,
    NotNegative,
    PlanFile,
    PoseData,
    Vector3,
)
from planner.files.json_csv import checked_file, read_json, write_json
from planner.files.plans import CONTACT_TOL, contact_data, numbers_of, plan_from_dict, plan_to_dict
from planner.hands.hand import Hand
from planner.motion import Knot, Limit, MotionPlan, MotionRecord, ObjectPath
from planner.motion.gait import GaitPlan, Relocation
from planner.motion.gait.verify import GaitVerifier
from planner.motion.manipulation import Ending, ManipulationPlan
from planner.motion.manipulation.ending import backwards, object_at_target
from planner.motion.manipulation.plan import torque_reserve
from planner.motion.release import verify_release
from planner.motion.verify import MotionVerifier, Waypoint
from planner.plan import GraspPlan
from planner.schema import StrictData
from planner.version import written_by

SAME = 1e-9
"""How far (rad, m) the first knot of a file may be from its grasp."""


class KnotData(StrictData):
    """One knot; joints in the order of the grasp's ``joint_names``."""

    place: Finite
    T_world_object: PoseData
    q_rad: list[Finite]
    contacts: list[ContactData]
    normalised_min_weight: Finite
    smallest_clearance_m: Finite
    off_path_m: NotNegative
    slips_m: list[NotNegative]


class PathData(StrictData):
    """The path of the object, world axes."""

    axis: Vector3
    angle_rad: Finite
    shift_m: Vector3


class LimitData(StrictData):
    """What kept the path from being longer."""

    what: str
    finger: str
    joint: str
    place: Finite
    gain: NotNegative
    unit: str

    @classmethod
    def of(cls, limit: Limit) -> LimitData:
        """From a limit."""
        same = {k: getattr(limit, k) for k in cls.model_fields if k != "place"}
        return cls(place=limit.path_parameter, **same)

    def limit(self) -> Limit:
        """As a limit."""
        return Limit(path_parameter=self.place, **self.model_dump(exclude={"place"}))


class MotionRecordData(StrictData):
    """Where the motion comes from."""

    seed: int
    attempt: int
    attempts: int
    iterations: int
    worst: Finite
    cpu_s: Finite
    build_s: Finite


class MotionFile(StrictData):
    """A motion plan as JSON."""

    format: Literal["opposable-motion"] = "opposable-motion"
    version: Literal[1] = 1
    written_by: str
    grasp: PlanFile
    path: PathData
    tube_m: NotNegative
    knots: list[KnotData]
    limits: list[LimitData]
    record: MotionRecordData


def motion_to_dict(plan: MotionPlan) -> dict[str, Any]:
    """A motion as plain data that follows ``MotionFile``."""
    data = MotionFile(
        written_by=written_by(),
        grasp=PlanFile.model_validate(plan_to_dict(plan.grasp)),
        path=PathData(
            axis=tuple(plan.path.axis), angle_rad=plan.path.angle, shift_m=tuple(plan.path.shift)
        ),
        tube_m=plan.path_tolerance,
        knots=[_knot_data(knot) for knot in plan.knots],
        limits=[LimitData.of(limit) for limit in plan.limits],
        record=MotionRecordData(
            **{k: getattr(plan.record, k) for k in MotionRecordData.model_fields}
        ),
    )
    return data.model_dump(mode="json")


def _knot_data(knot: Knot) -> KnotData:
    return KnotData(
        place=knot.path_parameter,
        T_world_object=PoseData.of(knot.T_world_object),
        q_rad=list(knot.q),
        contacts=contact_data(knot.contacts),
        normalised_min_weight=knot.closure.normalised_min_weight,
        smallest_clearance_m=knot.clearance,
        off_path_m=knot.off_path,
        slips_m=list(knot.slips),
    )


def write_motion(plan: MotionPlan, path: Path | str) -> None:
    """Write a motion file."""
    write_json(motion_to_dict(plan), path)


def read_motion(path: Path | str, *, hand: Hand | None = None) -> MotionPlan:
    """Read a motion file and check it.

    The plan is as ``plan_motion`` gave it: print it, go through its ``knots``, or have a controller
    of your own follow it (``sim.controllers.MotionReference``).

    Args:
        path: The file.
        hand: The hand to use; the one that the file names if None.

    Raises:
        FileFormatError: Damaged, of another version, or for another hand; or it does not hold.
        PlannerError: The hand or object cannot be loaded.
    """
    return motion_from_dict(read_json(path, "motion file"), str(path), hand=hand)


def motion_from_dict(data: dict[str, Any], source: str, *, hand: Hand | None = None) -> MotionPlan:
    """The motion that plain data hold, checked like a file.

    Args:
        data: What ``motion_to_dict`` gave.
        source: What errors call it, as the path of a file.
        hand: The hand to use; the one that the data name if None.

    Raises:
        FileFormatError: Damaged, of another version, or for another hand; or it does not hold.
        PlannerError: The hand or object cannot be loaded.
    """
    file = checked_file(MotionFile, data, source)
    grasp = plan_from_dict(data["grasp"], source, hand=hand)
    return _rebuild(file, grasp, source)


def _rebuild(file: MotionFile, grasp: GraspPlan, path: str) -> MotionPlan:
    try:
        covered = ObjectPath(
            axis=np.array(file.path.axis),
            angle=file.path.angle_rad,
            shift=np.array(file.path.shift_m),
        )
    except TaskError as error:
        raise FileFormatError(f"{path} is damaged: {error}") from error
    given = [k.place for k in file.knots]
    if len(given) < 2 or given[0] != 0.0 or given[-1] != 1.0 or np.diff(given).min() <= 0:
        raise FileFormatError(f"{path}: its knots do not go from 0 to 1 in order; it is damaged")
    waypoints = [
        Waypoint(
            path_parameter=k.place,
            T_object_base=k.T_world_object.pose().inverse() * grasp.T_world_base,
            q=grasp.task.hand.checked_q(k.q_rad, "q_rad"),
        )
        for k in file.knots
    ]
    if not np.allclose(waypoints[0].q, grasp.q, rtol=0.0, atol=SAME):
        raise FileFormatError(f"{path}: its first knot is not its grasp; it is damaged")
    verifier = MotionVerifier(grasp.task)
    knots = verifier.verify_knots(grasp.T_world_base, waypoints, covered, file.tube_m)
    if isinstance(knots, Failure):
        raise FileFormatError(f"{path} holds a motion that fails its checks: {knots}")
    for stored, knot in zip(file.knots, knots, strict=True):
        told, true = numbers_of(stored.contacts), numbers_of(contact_data(knot.contacts))
        if told.shape != true.shape or not np.allclose(
            told, true, atol=CONTACT_TOL, rtol=CONTACT_TOL
        ):
            raise FileFormatError(
                f"{path}: its contacts at {100 * stored.place:.0f} % of the path are not those of "
                "its joints; it is damaged"
            )
    return MotionPlan(
        grasp=grasp,
        path=covered,
        knots=knots,
        path_tolerance=file.tube_m,
        limits=tuple(data.limit() for data in file.limits),
        record=MotionRecord(**file.record.model_dump()),
    )


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


CONSISTENT = 1e-6
"""How far (m, rad, -) what a file tells may be from what follows from its motion."""


class EndingData(StrictData):
    """How the object is put down; joints in the order of the grasp's ``joint_names``.

    ``arm_out`` is the arm's way out, reversed, if the hand is on one.
    """

    T_world_target: PoseData
    q_open_rad: list[Finite]
    opening_m: NotNegative
    T_world_base_out: PoseData
    made_backwards_because: str
    arm_out: ArmData | None = None


class ManipulationFile(StrictData):
    """A manipulation plan as JSON, with either a motion or a gait."""

    format: Literal["opposable-manipulation"] = "opposable-manipulation"
    version: Literal[1] = 1
    written_by: str
    angle_rad: Finite
    shift_m: Vector3
    motion: MotionFile | None
    gait: GaitFile | None
    ending: EndingData
    torque_reserve: Finite
    attempts: int
    cpu_s: Finite


def manipulation_to_dict(plan: ManipulationPlan) -> dict[str, Any]:
    """A manipulation as plain data that follows ``ManipulationFile``."""
    ending, gait = plan.ending, plan.gait
    motion = None if gait else MotionFile.model_validate(motion_to_dict(plan.motion))
    data = ManipulationFile(
        written_by=written_by(),
        angle_rad=plan.angle,
        shift_m=tuple(plan.shift),
        motion=motion,
        gait=GaitFile.model_validate(gait_to_dict(gait)) if gait else None,
        ending=EndingData(
            T_world_target=PoseData.of(ending.T_world_target),
            q_open_rad=list(ending.release.q),
            opening_m=ending.release.pregrasp_distance,
            T_world_base_out=PoseData.of(ending.release.T_world_base_start),
            made_backwards_because=ending.back,
            arm_out=None if (arm := ending.release.arm) is None else ArmData.of(plan.grasp, arm),
        ),
        torque_reserve=plan.reserve,
        attempts=plan.attempts,
        cpu_s=plan.cpu_s,
    )
    return data.model_dump(mode="json")


def write_manipulation(plan: ManipulationPlan, path: Path | str) -> None:
    """Write a manipulation file."""
    write_json(manipulation_to_dict(plan), path)


def read_manipulation(path: Path | str, *, hand: Hand | None = None) -> ManipulationPlan:
    """Read a manipulation file and check it.

    The plan is as ``plan_manipulation`` gave it: print it, execute it with ``sim.manipulate``, or
    take its ``joint_trajectory`` to a hand.

    Args:
        path: The file.
        hand: The hand to use; the one that the file names if None.

    Raises:
        FileFormatError: Damaged, of another version, or for another hand; or it does not hold.
        PlannerError: The hand or object cannot be loaded.
    """
    return manipulation_from_dict(read_json(path, "manipulation file"), str(path), hand=hand)


def given_manipulation(given: ManipulationPlan | Path | str) -> ManipulationPlan:
    """A plan as it is, or read from its file.

    Raises:
        FileFormatError: As ``read_manipulation``.
        TaskError: Neither the plan of a manipulation nor a path.
    """
    if isinstance(given, str | Path):
        return read_manipulation(given)
    if not isinstance(given, ManipulationPlan):
        raise TaskError(
            f"{shown(given)} is a {type(given).__name__}; give the plan of a manipulation, as "
            "plan_manipulation and manipulation_of return it, or the path of its file"
        )
    return given


def manipulation_from_dict(
    data: dict[str, Any], source: str, *, hand: Hand | None = None
) -> ManipulationPlan:
    """The manipulation that plain data hold, checked like a file.

    Args:
        data: What ``manipulation_to_dict`` gave.
        source: What errors call it, as the path of a file.
        hand: The hand to use; the one that the data name if None.

    Raises:
        FileFormatError: Damaged, of another version, or for another hand; or it does not hold.
        PlannerError: The hand or object cannot be loaded.
    """
    file = checked_file(ManipulationFile, data, source)
    if (file.motion is None) == (file.gait is None):
        raise FileFormatError(f"{source} holds a motion and a gait, or neither; give one of them")
    gait = None if file.gait is None else gait_from_dict(data["gait"], source, hand=hand)
    motion = gait.motion if gait else motion_from_dict(data["motion"], source, hand=hand)
    way_out = file.ending.arm_out
    release = Approach(
        q=motion.grasp.task.hand.checked_q(file.ending.q_open_rad, "q_open_rad"),
        pregrasp_distance=file.ending.opening_m,
        T_world_base_start=file.ending.T_world_base_out.pose(),
        arm=None if way_out is None else way_out.path(motion.grasp.task.hand),
    )
    plan = ManipulationPlan(
        motion=motion,
        gait=gait,
        angle=file.angle_rad,
        shift=np.array(file.shift_m),
        ending=Ending(
            T_world_target=file.ending.T_world_target.pose(),
            release=release,
            back=file.ending.made_backwards_because,
        ),
        reserve=file.torque_reserve,
        attempts=file.attempts,
        cpu_s=file.cpu_s,
    )
    fault = _fault(plan)
    if fault:
        raise FileFormatError(f"{source}: {fault}; it is damaged")
    return plan


def _fault(plan: ManipulationPlan) -> str:
    """What a plan tells that does not follow from its motion, "" if nothing."""
    motion, ending = plan.motion, plan.ending
    path, whole = motion.path, (plan.gait or motion.path)
    if plan.angle * whole.angle < 0.0 or abs(plan.angle) > abs(whole.angle) + CONSISTENT:
        return (
            f"it is to turn by {np.rad2deg(plan.angle):.1f} degrees and its motion by "
            f"{np.rad2deg(whole.angle):.1f}"
        )
    share = plan.angle / whole.angle if whole.angle else 1.0
    if not np.allclose(share * whole.shift, plan.shift, rtol=0.0, atol=CONSISTENT):
        return "its translation is not that of its motion"
    x, y, _ = ending.T_world_target.translation
    made = 0.0 if ending.back else plan.angle
    target = object_at_target(plan.task, path.axis, made, (x, y))
    if not target.isApprox(ending.T_world_target, CONSISTENT):
        return "its object does not stand at its target as it was turned"
    if ending.back:
        grasp, way_in = ending.release, backwards(motion, (x, y), ending.back).release
        same = np.allclose(grasp.q, way_in.q, rtol=0.0, atol=CONSISTENT)
        if not (same and grasp.T_world_base_start.isApprox(way_in.T_world_base_start, CONSISTENT)):
            return "its way out is not its way in, though the motion is made backwards"
    elif fault := verify_release(motion, ending.release):
        return f"its way out fails its checks: {fault}"
    if abs(torque_reserve(motion) - plan.reserve) > RESERVE_TOL:
        return "its torque reserve is not that of its forces"
    return ""


RESERVE_TOL = 1e-3
"""How far (-) a torque reserve may be from that of the forces that are computed again."""
