"""Motion files: versioned JSON with the grasp, the path, and the object and joints at every knot.

As with grasps, nothing in a file is believed: the hand's digest is checked, and grasp and knots are
judged again on the true geometry. A file whose contacts are not those of its joints is refused.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np

from planner.errors import FileFormatError, TaskError
from planner.failure import Failure
from planner.files.data import ContactData, Finite, NotNegative, PlanFile, PoseData, Vector3
from planner.files.json_csv import checked_file, read_json, write_json
from planner.files.plans import (
    CONTACT_TOL,
    contact_data,
    numbers_of,
    plan_from_dict,
    plan_to_dict,
)
from planner.hands.hand import Hand
from planner.motion import Knot, Limit, MotionPlan, MotionRecord, ObjectPath
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
