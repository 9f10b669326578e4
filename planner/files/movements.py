"""Movement files: versioned JSON with the grasp, the phases of the movement, and its ending.

A file holds the path and the knots of the first stroke, how the fingers move on after it, how often
both are repeated, and how the object is put down, where that is planned. Later cycles are the first
one with the object further along. A file with a tool has its frames, its use and the way of the
hand too; one with a handover has the grasps of both hands.

Nothing in a file is believed: the hand's digest is checked, and grasp, knots and way out are judged
again on the true geometry; orders and swings of fingers are searched again. A file whose contacts,
relocations, target or torque reserve are not those of its joints is refused.

Files of the formats that this one replaces are read as well: ``opposable-motion``,
``opposable-gait`` and ``opposable-manipulation``, version 1 (``as_movement``), and handovers
(``planner.files.handovers``).
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from planner.collision.pregrasp import Approach
from planner.errors import FileFormatError, TaskError, shown
from planner.failure import Failure
from planner.files.data import ArmData, ContactData, LaterData, ObjectData, PlanFile, PoseData
from planner.files.disk import (
    HANDOVER_FORMAT,
    MOVEMENT_FORMATS,
    checked_file,
    read_json,
    write_json,
)
from planner.files.handovers import HandoverData, HandoverFile
from planner.files.plans import CONTACT_TOL, contact_data, numbers_of, plan_from_dict, plan_to_dict
from planner.hands.hand import Hand
from planner.motion.ending import backwards, object_at_target, verify_release, verify_turned
from planner.motion.path import ObjectPath, checked_attitude
from planner.motion.phase import Ending, Knot, Relocation, ToolUse
from planner.motion.plan import Limit, ManipulationPlan, MotionRecord, MovementPlan
from planner.motion.tool_gait import verify_tool_gait
from planner.motion.tool_use import with_use
from planner.motion.verify import MovementVerifier, Waypoint
from planner.plan import GraspPlan
from planner.schema import Finite, NotNegative, StrictData, Vector3
from planner.shapes.registry import shape_key
from planner.spatial import FloatArray
from planner.system.package import written_by
from planner.task import GraspTask
from planner.tools import Tool, UseData, use_data

SAME = 1e-9
"""How far (rad, m) the first knot of a file may be from its grasp."""

CONSISTENT = 1e-6
"""How far (m, rad, -) what a file says may be from what follows from its movement."""

RESERVE_TOL = 1e-3
"""How far (-) a torque reserve may be from that of the forces that are computed again."""

QUATERNION = "quaternion_wxyz"
"""Field of a pose whose sign means nothing; of a half turn rounding decides it."""

MOST_CYCLES = 1000
"""Most cycles of a file: each is judged when it is read."""


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


class PathData(LaterData):
    """The path of the object, world axes; no attitude is that of the grasp."""

    later = "attitude"

    axis: Vector3
    angle_rad: Finite
    shift_m: Vector3
    attitude: tuple[Vector3, Vector3, Vector3] | None = None


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


class RelocationData(StrictData):
    """One finger that moves on after the first stroke; joints in the order of the grasp's."""

    finger: str
    q_rad: list[list[Finite]]
    contacts_held: list[ContactData]
    contacts_after: list[ContactData]
    normalised_min_weight: Finite


class EndingData(LaterData):
    """How the object is put down; joints in the order of the grasp's ``joint_names``.

    ``arm_out`` is the arm's way out, reversed, if the hand is on one. ``turned`` is true where the
    hand stays in the path's attitude; then ``q_open_rad`` is null if the object is held at last.
    """

    later = "turned"

    T_world_target: PoseData
    q_open_rad: list[Finite] | None
    opening_m: NotNegative
    T_world_base_out: PoseData | None
    made_backwards_because: str
    arm_out: ArmData | None = None
    turned: bool = False


class ToolData(LaterData):
    """The tool of a use, in the frame of its object; ``object`` where the grasp is of another.

    What its use needs is in the task of the grasp.
    """

    later = "object"

    tip_m: Vector3
    axis: Vector3
    use: UseData
    grip_N: float | None
    scale: Finite
    object: ObjectData | None = None

    @classmethod
    def of(cls, tool: Tool, task: GraspTask) -> ToolData:
        """From a tool, and the task that was planned for it."""
        same = shape_key(tool.shape) == shape_key(task.object.shape)
        return cls(
            tip_m=tuple(tool.tip),
            axis=tuple(tool.axis),
            use=use_data(tool),
            grip_N=tool.grip_force,
            scale=tool.scale,
            object=None if same else ObjectData.of(tool),
        )

    def tool(self, task: GraspTask) -> Tool:
        """The tool, for the task that was planned for it."""
        item = task.object if self.object is None else self.object.object()
        return Tool(
            name=item.name,
            shape=item.shape,
            mass=item.mass,
            touch=item.touch,
            tip=np.array(self.tip_m),
            axis=np.array(self.axis),
            needed=task.needed,
            use=self.use,
            grip_force=self.grip_N,
            scale=self.scale,
        )


class ToolUseData(StrictData):
    """The way of the base in the use of a tool, or of a finger that does not hold."""

    T_world_base: list[PoseData] = Field(min_length=1)
    finger: str
    q_rad: list[list[Finite]]


class MovementFile(LaterData):
    """A movement of an object in the hand as JSON.

    ``path``, ``knots`` and ``limits`` are those of one stroke, ``relocations`` those after it;
    ``cycles`` is the number of strokes. ``angle_rad`` and ``shift_m`` are what was requested, which
    the strokes may exceed. ``ending`` is null where it is not planned how the object is put down,
    ``torque_reserve`` in files of older formats without one. ``then`` is the movement that begins
    where this one has put the object down, null or left out for none. ``tool`` is what is used, by
    the strokes or, with ``tool_use``, by the hand as a whole; ``handover`` is how another hand
    takes the object.
    """

    later = "then tool tool_use handover"

    format: Literal["opposable-movement"] = "opposable-movement"
    version: Literal[1] = 1
    written_by: str
    grasp: PlanFile
    path: PathData
    tube_m: NotNegative
    knots: list[KnotData]
    limits: list[LimitData]
    cycles: int = Field(ge=1, le=MOST_CYCLES)
    relocations: list[RelocationData]
    angle_rad: Finite
    shift_m: Vector3
    ending: EndingData | None
    torque_reserve: Finite | None
    record: MotionRecordData
    then: MovementFile | None = None
    tool: ToolData | None = None
    tool_use: ToolUseData | None = None
    handover: HandoverData | None = None

    @model_validator(mode="after")
    def _one_of_them(self) -> Self:
        if self.handover is not None and (self.tool_use is not None or self.tool is not None):
            raise ValueError("it has a tool and a handover; a movement has one of them at most")
        if self.tool_use is not None and self.tool is None:
            raise ValueError("it has a tool_use and no tool")
        return self


def movement_to_dict(plan: MovementPlan) -> dict[str, Any]:
    """A movement as plain data that follows ``MovementFile``."""
    data = MovementFile(
        written_by=written_by(),
        grasp=PlanFile.model_validate(plan_to_dict(plan.grasp)),
        path=_path_data(plan.path),
        tube_m=plan.path_tolerance,
        knots=[_knot_data(knot) for knot in plan.knots],
        limits=[LimitData.of(limit) for limit in plan.limits],
        cycles=plan.cycles,
        relocations=[_relocation_data(r) for r in plan.regrasps],
        angle_rad=plan.angle,
        shift_m=tuple(plan.shift),
        ending=None if plan.ending is None else _ending_data(plan.grasp, plan.ending),
        torque_reserve=plan.reserve,
        record=MotionRecordData.model_validate(plan.record, from_attributes=True),
        tool=None if plan.tool is None else ToolData.of(plan.tool, plan.task),
        tool_use=None if plan.tool_use is None else _use_data(plan.tool_use),
        handover=None if plan.handover is None else HandoverData.of(plan.handover),
    )
    written: dict[str, Any] = data.model_dump(mode="json")
    return written if plan.then is None else {**written, "then": movement_to_dict(plan.then)}


def _use_data(use: ToolUse) -> ToolUseData:
    return ToolUseData(
        T_world_base=[PoseData.of(pose) for pose in use.way],
        finger=use.finger,
        q_rad=use.postures.tolist(),
    )


def _path_data(path: ObjectPath) -> PathData:
    rows = path.attitude.tolist() if path.turns_wrist else None
    return PathData(
        axis=tuple(path.axis), angle_rad=path.angle, shift_m=tuple(path.shift), attitude=rows
    )


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


def _relocation_data(relocation: Relocation) -> RelocationData:
    return RelocationData(
        finger=relocation.finger,
        q_rad=relocation.postures.tolist(),
        contacts_held=contact_data(relocation.during),
        contacts_after=contact_data(relocation.after),
        normalised_min_weight=relocation.margin,
    )


def _ending_data(grasp: GraspPlan, ending: Ending) -> EndingData:
    release = ending.release
    arm = None if release is None else release.arm
    return EndingData(
        T_world_target=PoseData.of(ending.T_world_target),
        q_open_rad=None if release is None else list(release.q),
        opening_m=0.0 if release is None else release.pregrasp_distance,
        T_world_base_out=None if release is None else PoseData.of(release.T_world_base_start),
        made_backwards_because=ending.back,
        arm_out=None if arm is None else ArmData.of(grasp, arm),
        turned=ending.turned,
    )


def as_movement(data: dict[str, Any], source: str) -> dict[str, Any]:
    """Plain data of an older format as those of ``MovementFile``; any other data as they are.

    Nothing is checked but what is moved: the rest is for ``MovementFile``.

    Args:
        data: What a file holds.
        source: What errors call it.

    Raises:
        FileFormatError: Of another version, or not as that format has it.
    """
    kind = data.get("format")
    if kind not in MOVEMENT_FORMATS[1:]:
        return data
    if data.get("version") != 1:
        raise FileFormatError(
            f"{source} is of version {shown(data.get('version'))} of {kind}; this program reads "
            "version 1 of it"
        )
    try:
        return _older_whole(data) if kind == "opposable-manipulation" else _older_strokes(data)
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise FileFormatError(
            f"{source} is damaged: its fields are not those of {kind} "
            f"({type(error).__name__}: {error})"
        ) from error


def _older_strokes(data: dict[str, Any]) -> dict[str, Any]:
    """Data of a motion or a gait as those of a movement, all of which is requested."""
    _only(data, "opposable-motion", "opposable-gait")
    gait = data["format"] == "opposable-gait"
    stroke, cycles = (data["stroke"], data["cycles"]) if gait else (data, 1)
    if not (isinstance(cycles, int) and 1 <= cycles <= MOST_CYCLES):
        raise ValueError(f"cycles is not a number from 1 to {MOST_CYCLES}")
    path = stroke["path"]
    return {
        **stroke,
        "format": "opposable-movement",
        "cycles": cycles,
        "relocations": data["relocations"] if gait else [],
        "angle_rad": cycles * float(path["angle_rad"]),
        "shift_m": [cycles * float(x) for x in path["shift_m"]],
        "ending": None,
        "torque_reserve": None,
    }


def _older_whole(data: dict[str, Any]) -> dict[str, Any]:
    """Data of a manipulation as those of a movement."""
    _only(data, "opposable-manipulation")
    parts = [data[name] for name in ("motion", "gait") if data[name] is not None]
    if len(parts) != 1:
        raise TypeError("it holds a motion and a gait, or neither")
    strokes = _older_strokes(parts[0])
    spent = {name: data[name] for name in ("attempts", "cpu_s")}
    asked = {name: data[name] for name in ("angle_rad", "shift_m", "ending", "torque_reserve")}
    return {**strokes, **asked, "record": {**strokes["record"], **spent}}


_FIELDS = {
    "opposable-gait": "format version written_by cycles stroke relocations",
    "opposable-manipulation": (
        "format version written_by angle_rad shift_m motion gait ending torque_reserve attempts "
        "cpu_s"
    ),
}
"""Fields of older formats that hold a motion; those of a motion are the movement's own."""


def _only(data: dict[str, Any], *kinds: str) -> None:
    """Refuse data of another format than these, of another version, or with other fields.

    Raises:
        ValueError: So.
    """
    kind = data["format"]
    if kind not in kinds or data["version"] != 1:
        raise ValueError(f"a part is not version 1 of {' or '.join(kinds)}")
    more = set(data) - set(_FIELDS[kind].split()) if kind in _FIELDS else ()
    if more:
        raise ValueError(f"{', '.join(sorted(more))} is no field of {kind}")


def write_movement(plan: MovementPlan, path: Path | str) -> None:
    """Write a movement file."""
    write_json(movement_to_dict(plan), path)


def read_movement(path: Path | str, *, hand: Hand | None = None) -> MovementPlan:
    """Read a movement file and check it.

    The plan is as ``plan_motion``, ``plan_gait`` or ``plan_manipulation`` gave it: print it, go
    through its ``phases``, have a controller of your own follow it
    (``sim.controllers.MotionReference``), or take its ``joint_trajectory`` to a hand.

    Args:
        path: The file, of this format or of one that it replaces.
        hand: The hand to use; the one that the file names if None.

    Returns:
        The plan; a ``ManipulationPlan``, which ``sim.manipulate`` executes, if it has an ending.

    Raises:
        FileFormatError: Damaged, of another version, or for another hand; or it does not hold.
        PlannerError: The hand or object cannot be loaded.
    """
    return movement_from_dict(read_json(path, "movement file"), str(path), hand=hand)


def movement_from_dict(
    data: dict[str, Any], source: str, *, hand: Hand | None = None
) -> MovementPlan:
    """The movement that plain data hold, checked like a file.

    Args:
        data: What ``movement_to_dict`` gave, or data of an older format.
        source: What errors call it, as the path of a file.
        hand: The hand to use; the one that the data name if None.

    Raises:
        FileFormatError: Damaged, of another version, or for another hand; or it does not hold.
        PlannerError: The hand or object cannot be loaded.
    """
    if data.get("format") == HANDOVER_FORMAT:
        return checked_file(HandoverFile, data, source).movement(source)
    data = as_movement(data, source)
    file = checked_file(MovementFile, data, source)
    if file.handover is not None:
        return _handed_over(file, file.handover, source)
    grasp = plan_from_dict(data["grasp"], source, hand=hand)
    if file.tool_use is not None:
        return _used(file, file.tool_use, grasp, source)
    plan = _strokes(file, grasp, source)
    if file.tool is not None:
        plan = replace(plan, tool=file.tool.tool(grasp.task))
    if file.ending is None:
        plan = replace(plan, angle=file.angle_rad, shift=np.array(file.shift_m))
    else:
        plan = _whole(plan, file, file.ending, source)
    fault = _fault(plan, file.torque_reserve)
    if fault:
        raise FileFormatError(f"{source}: {fault}; it is damaged")
    if plan.tool is not None:
        blocked = verify_tool_gait(plan)
        if blocked is not None:
            raise FileFormatError(f"{source} holds strokes that fail their checks: {blocked}")
    if data.get("then") is None:
        return plan
    then = manipulation_from_dict(data["then"], f"{source}, what follows", hand=hand)
    first = None if plan.ending is None else plan.ending.T_world_target
    if first is None or not first.isApprox(then.task.T_world_object, CONSISTENT):
        raise FileFormatError(f"{source}: what follows begins elsewhere; it is damaged")
    return replace(plan, then=then)


def _handed_over(file: MovementFile, handover: HandoverData, source: str) -> ManipulationPlan:
    """The handover of a file, put together again.

    Raises:
        FileFormatError: It fails its checks, or the file says something else beside.
    """
    plan = handover.movement(source)
    _refuse_others(file, plan, source)
    return plan


def _used(file: MovementFile, use: ToolUseData, grasp: GraspPlan, source: str) -> ManipulationPlan:
    """The use of a tool by the hand as a whole, judged again.

    Raises:
        FileFormatError: The hand cannot go there, or the file says something else beside.
    """
    assert file.tool is not None  # as the file was checked
    tool, hand = file.tool.tool(grasp.task), grasp.task.hand
    phase = ToolUse(
        way=tuple(pose.pose() for pose in use.T_world_base),
        finger=use.finger,
        postures=np.array([hand.checked_q(q, "q_rad") for q in use.q_rad]).reshape(-1, hand.nq),
    )
    try:
        found = with_use(replace(grasp, task=replace(grasp.task, object=tool)), phase)
    except TaskError as error:
        raise FileFormatError(f"{source} is damaged: {error}") from error
    if isinstance(found, Failure):
        raise FileFormatError(f"{source} holds a use that fails its checks: {found}")
    _refuse_others(file, found, source)
    return found


RETOLD = {"written_by", "record", "torque_reserve", "handover", "tool", "then"}
"""Fields of a use or a handover that are not compared with what follows from the others."""


def _refuse_others(file: MovementFile, plan: MovementPlan, source: str) -> None:
    """Refuse a file of a use or a handover whose other fields are not those of its plan.

    Raises:
        FileFormatError: One is another.
    """
    true = MovementFile.model_validate(movement_to_dict(plan))
    told, own = (
        {k: v for k, v in f.model_dump().items() if k not in RETOLD}
        | {"grasp": f.grasp.grasp.model_dump()}
        for f in (file, true)
    )
    other = _other(told, own)
    if file.then is not None or other:
        raise FileFormatError(
            f"{source}: {other or 'then'} is not what follows from its grasps; it is damaged"
        )


def _other(told: Any, true: Any, name: str = "") -> str:
    """Name of the first value of plain data that is not the true one, "" if all are."""
    if isinstance(true, dict) and isinstance(told, dict):
        if told.keys() != true.keys():
            return f"{name}.{min(told.keys() ^ true.keys())}".strip(".")
        if (sign := QUATERNION) in true and np.dot(told[sign], true[sign]) < 0.0:  # the same turn
            told = {**told, sign: [-v for v in told[sign]]}
        found = (_other(told[key], true[key], f"{name}.{key}".strip(".")) for key in true)
        return next(filter(None, found), "")
    if isinstance(true, list | tuple) and isinstance(told, list | tuple) and len(told) == len(true):
        found = (
            _other(a, b, f"{name}[{k}]") for k, (a, b) in enumerate(zip(told, true, strict=True))
        )
        return next(filter(None, found), "")
    if isinstance(true, float) and isinstance(told, float | int):
        return "" if _same(np.array(told, dtype=float), np.array(true)) else name
    return "" if told == true else name


def _strokes(file: MovementFile, grasp: GraspPlan, path: str) -> MovementPlan:
    """The strokes and relocations of a file, judged again."""
    try:
        covered = ObjectPath(
            axis=np.array(file.path.axis),
            angle=file.path.angle_rad,
            shift=np.array(file.path.shift_m),
            attitude=checked_attitude(file.path.attitude or "down"),
            stays=file.path.angle_rad == 0.0 and not any(file.path.shift_m),
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
    verifier = MovementVerifier(grasp.task)
    knots = verifier.verify_knots(grasp.T_world_base, waypoints, covered, file.tube_m)
    if isinstance(knots, Failure):
        raise FileFormatError(f"{path} holds a movement that fails its checks: {knots}")
    for stored, knot in zip(file.knots, knots, strict=True):
        if not _same(numbers_of(stored.contacts), numbers_of(contact_data(knot.contacts))):
            raise FileFormatError(
                f"{path}: its contacts at {100 * stored.place:.0f} % of the path are not those of "
                "its joints; it is damaged"
            )
    stroke = MovementPlan.of_stroke(
        grasp,
        covered,
        knots,
        path_tolerance=file.tube_m,
        record=MotionRecord(**file.record.model_dump()),
        limits=tuple(data.limit() for data in file.limits),
    )
    if file.cycles == 1 and not file.relocations:
        return stroke
    plan = verifier.repeated(stroke, file.cycles)
    if isinstance(plan, Failure):
        raise FileFormatError(f"{path} holds a movement that fails its checks: {plan}")
    true = [_relocation_data(r) for r in plan.regrasps]
    if [r.finger for r in file.relocations] != [r.finger for r in true]:
        raise FileFormatError(f"{path}: its fingers move on in another order; it is damaged")
    for told, found in zip(file.relocations, true, strict=True):
        for what, a, b in (
            ("way", np.ravel(told.q_rad), np.ravel(found.q_rad)),
            ("contacts", numbers_of(told.contacts_held), numbers_of(found.contacts_held)),
            ("contacts", numbers_of(told.contacts_after), numbers_of(found.contacts_after)),
        ):
            if not _same(a, b):
                raise FileFormatError(
                    f"{path}: the {what} with {told.finger} away are not those of its stroke; it "
                    "is damaged"
                )
    return plan


def _same(stored: FloatArray, true: FloatArray) -> bool:
    """Whether numbers of a file are those that follow from its joints."""
    return stored.shape == true.shape and np.allclose(
        stored, true, atol=CONTACT_TOL, rtol=CONTACT_TOL
    )


def _whole(
    strokes: MovementPlan, file: MovementFile, ending: EndingData, source: str
) -> ManipulationPlan:
    """Strokes with the ending of a file, not judged yet.

    Raises:
        FileFormatError: It has a part of a way out.
    """
    hand, arm = strokes.task.hand, ending.arm_out
    release = None
    if (ending.q_open_rad is None) != (ending.T_world_base_out is None) or (
        ending.q_open_rad is None and not ending.turned
    ):
        raise FileFormatError(
            f"{source}: its ending has a part of a way out only; q_open_rad and T_world_base_out "
            "are both given, or both null where the object is held at its goal: it is damaged"
        )
    if ending.q_open_rad is not None and ending.T_world_base_out is not None:
        release = Approach(
            q=hand.checked_q(ending.q_open_rad, "q_open_rad"),
            pregrasp_distance=ending.opening_m,
            T_world_base_start=ending.T_world_base_out.pose(),
            arm=None if arm is None else arm.path(hand),
        )
    made = Ending(
        T_world_target=ending.T_world_target.pose(),
        release=release,
        back=ending.made_backwards_because,
        turned=ending.turned,
    )
    return ManipulationPlan.of(strokes, made, angle=file.angle_rad, shift=np.array(file.shift_m))


def _fault(plan: MovementPlan, reserve: float | None) -> str:
    """What a file says that does not follow from its movement, "" if nothing."""
    whole, made = plan.planned_angle, plan.planned_shift
    if plan.angle * whole < 0.0 or abs(plan.angle) > abs(whole) + CONSISTENT:
        return (
            f"it is to turn by {np.rad2deg(plan.angle):.1f} degrees and its motion by "
            f"{np.rad2deg(whole):.1f}"
        )
    share = plan.angle / whole if whole else 1.0
    if not np.allclose(share * made, plan.shift, rtol=0.0, atol=CONSISTENT):
        return "its translation is not that of its motion"
    if reserve is not None and abs(plan.reserve - reserve) > RESERVE_TOL:
        return "its torque reserve is not that of its forces"
    return "" if plan.ending is None else _fault_of_ending(plan, plan.ending)


def _fault_of_ending(plan: MovementPlan, ending: Ending) -> str:
    """The same of how the object is put down."""
    if ending.back and plan.cycles > 1:
        return f"its {plan.cycles} strokes are said to be made backwards, which only one is"
    if ending.turned:
        failure = verify_turned(plan, ending)
        return "" if failure is None else f"its ending fails its checks: {failure}"
    if ending.release is None:
        return "it holds its object at last, but its wrist turns back"
    x, y, _ = ending.T_world_target.translation
    made = 0.0 if ending.back else plan.angle
    target = object_at_target(plan.task, plan.path.axis, made, (x, y))
    if not target.isApprox(ending.T_world_target, CONSISTENT):
        return "its object does not stand at its target as it was turned"
    if ending.back:
        grasp, way_in = ending.release, backwards(plan, (x, y), ending.back).release
        assert way_in is not None  # a hand that goes back lets go
        same = np.allclose(grasp.q, way_in.q, rtol=0.0, atol=CONSISTENT)
        if not (same and grasp.T_world_base_start.isApprox(way_in.T_world_base_start, CONSISTENT)):
            return "its way out is not its way in, though the motion is made backwards"
    elif fault := verify_release(plan, ending.release):
        return f"its way out fails its checks: {fault}"
    return ""


def manipulation_from_dict(
    data: dict[str, Any], source: str, *, hand: Hand | None = None
) -> ManipulationPlan:
    """A movement with an ending out of plain data; see ``movement_from_dict``.

    Raises:
        FileFormatError: As there; or it has no ending.
        PlannerError: The hand or object cannot be loaded.
    """
    plan = movement_from_dict(data, source, hand=hand)
    if not isinstance(plan, ManipulationPlan):
        raise FileFormatError(
            f"{source} holds a movement without an ending; give one that says how the object is "
            "put down: manipulation_of(plan) plans that"
        )
    return plan


def read_manipulation(path: Path | str, *, hand: Hand | None = None) -> ManipulationPlan:
    """Read the file of a movement with an ending; see ``read_movement``.

    Raises:
        FileFormatError: As there; or it has no ending.
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


read_motion = read_gait = read_movement
write_motion = write_gait = write_manipulation = write_movement
"""Names that files of one stroke, of several and with an ending had while they were three kinds."""
