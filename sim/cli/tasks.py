"""What is to be grasped, where, by which fingers: options, and how objects and places are written.

Lengths are m, angles degrees.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from rich.markup import escape

from planner.tolerances import DEFAULT_MU
from sim.cli.common import err, say
from sim.cli.options import (
    GRIP,
    SCENE,
    FingersOption,
    JointErrorOption,
    MassOption,
    MuOption,
    StandOption,
    TypeOption,
    flag,
    names,
    numbers,
    option,
)

if TYPE_CHECKING:
    from planner.forces import ExpectedLoad
    from planner.hands.hand import Hand
    from planner.objects import GraspObject, TouchRegion
    from planner.spatial import SE3
    from planner.task import GraspTask, Obstacle

PLACE, POSITION, POSE = 2, 3, 6
"""Numbers of a place on the table, a position, a pose."""

POSE_FORM = "x,y,z or x,y,z,roll,pitch,yaw"
"""How a pose is written: m in the world, and degrees about the world's fixed axes x, y, z."""

OBSTACLE_FORM = "box:XxYxZ@x,y,z or box:XxYxZ@x,y,z,roll,pitch,yaw"
"""How an obstacle is written: full extents and pose of its centre."""

GRAVITY = "0,0,-9.81"
"""Gravity if nothing is said, m/s2, world."""


def pose_of(option: str, text: str) -> SE3:
    """A pose: R = Rz(yaw) Ry(pitch) Rx(roll); no rotation if only a position is given.

    Args:
        option: Where the text was given, for messages.
        text: As ``POSE_FORM`` says.

    Raises:
        TaskError: Something else than three or six finite numbers.
    """
    import numpy as np
    import pinocchio as pin

    from planner.errors import TaskError
    from planner.spatial import SE3

    count = text.count(",") + 1
    if count not in (POSITION, POSE):
        raise TaskError(
            f"{option} {text!r} has {count} numbers; give {POSE_FORM}, in m and degrees"
        )
    values = numbers(option, text, count)
    roll, pitch, yaw = (math.radians(v) for v in (values[POSITION:] or (0.0, 0.0, 0.0)))
    return SE3(pin.rpy.rpyToMatrix(roll, pitch, yaw), np.array(values[:POSITION]))


def obstacle_of(text: str, number: int) -> Obstacle:
    """A fixed box.

    Args:
        text: As ``OBSTACLE_FORM`` says.
        number: Which one, from 1; its name in messages.

    Raises:
        TaskError: Another shape, or something else than sizes > 0 and a pose.
    """
    import numpy as np

    from planner.errors import TaskError
    from planner.objects import parse_object
    from planner.shapes import Box
    from planner.task import Obstacle

    what, at, pose = text.partition("@")
    box = parse_object(what).shape if at else None
    if not isinstance(box, Box):
        raise TaskError(
            f"--obstacle {text!r} is not a box with a place; give {OBSTACLE_FORM}, in m and "
            "degrees; several boxes stand for another shape"
        )
    return Obstacle(
        name=f"obstacle {number}",
        size=np.array(box.size),
        T_world_obstacle=pose_of("--obstacle", pose),
    )


def length_of(name: str, text: str) -> float:
    """A length in m of "0.002", "2mm" or "2 mm".

    Raises:
        TaskError: Something else.
    """
    from planner.errors import TaskError

    number = text.strip().lower()
    scale = 1.0
    if number.endswith("mm"):
        number, scale = number[:-2], 1e-3
    elif number.endswith("m"):
        number = number[:-1]
    try:
        value = float(number) * scale
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value >= 0.0):
        raise TaskError(f"{name} {text!r} is no length >= 0; write 2mm, or 0.002 in m")
    return value


def error_of(name: str, text: str) -> tuple[float, float]:
    """A length, m, and an angle, rad, of "5mm,5".

    Raises:
        TaskError: Something else.
    """
    from planner.errors import TaskError

    length, comma, degrees = text.partition(",")
    try:
        turn = numbers(name, degrees, 1)[0] if comma else 0.0
        shift = length_of(name, length)
    except TaskError as error:
        raise TaskError(
            f"{error}; an error of a pose is a length and degrees, 5mm,5, or the length alone"
        ) from error
    if shift > MOST_SHIFT or not 0.0 <= turn <= MOST_DEGREES:
        raise TaskError(
            f"{name} {text!r} is {shift:g} m and {turn:g} degrees; give at most {MOST_SHIFT:g} m, "
            f"as 5mm, and 0 to {MOST_DEGREES:g} degrees"
        )
    return shift, math.radians(turn)


MOST_SHIFT, MOST_DEGREES = 0.1, 28.0
"""Largest error of a calibration, m and degrees: more is a wrong unit (``sim.scan``)."""


def table_of(text: str) -> float | None:
    """Height of the table's top, m; None for no table.

    Raises:
        TaskError: Neither a finite number nor ``none``.
    """
    from planner.errors import TaskError

    if text.strip().lower() == "none":
        return None
    try:
        return numbers("--table", text, 1)[0]
    except TaskError as error:
        raise TaskError(f"{error}, the height of its top in m, or none for no table") from error


def is_cloud(spec: str) -> bool:
    """Whether an object is given by the points that cameras saw of it."""
    if not Path(spec).suffix[1:].isalpha():  # no file: its reader need not be loaded
        return False
    from planner.clouds.files import is_cloud_file

    return is_cloud_file(spec)


def object_of(spec: str, **options: Any) -> GraspObject:
    """As ``parse_object``; a line on stderr says what of a mesh was mended.

    Raises:
        PlannerError: An unknown name, or something that cannot be.
    """
    from planner.objects import parse_object

    item = parse_object(spec, **options)
    if item.mended:
        file = escape(spec.rpartition("/")[2])
        say(err, f"[yellow]{file}: {escape(item.mended)}; --strict refuses instead[/]")
    return item


@dataclass(frozen=True, kw_only=True)
class TaskOptions:
    """What commands that plan take of object, surroundings and hand."""

    pose: Annotated[int, option("Which of its stable poses it stands in.", "N", SCENE, min=0)] = 0
    at: Annotated[
        str | None,
        option(
            "x,y where it stands, or x,y,z of its centre, m[,roll,pitch,yaw, degrees].",
            "POSE",
            SCENE,
        ),
    ] = None
    mass: MassOption = None
    density: Annotated[float | None, option("kg/m3, instead of its mass.", "RHO", SCENE)] = None
    repair: Annotated[bool, flag("--repair", "Mend its mesh however much that changes.", SCENE)] = (
        False
    )
    strict: Annotated[bool, flag("--strict", "Refuse a mesh that would be mended.", SCENE)] = False
    touch: Annotated[
        list[str] | None, option("Where it may be touched: z>0.01,x<0.02 (m).", "REGION", SCENE)
    ] = None
    avoid: Annotated[
        list[str] | None, option("Where it must not be touched, likewise.", "REGION", SCENE)
    ] = None
    table: Annotated[str, option("Height of the table's top, m, or none.", "Z|none", SCENE)] = "0"
    stand: StandOption = 0.0
    obstacle: Annotated[
        list[str] | None, option("Fixed box:XxYxZ@POSE; repeatable.", "BOX", SCENE)
    ] = None
    gravity: Annotated[str, option("In m/s2.", "X,Y,Z", SCENE)] = GRAVITY
    fingers: FingersOption = None
    type: TypeOption = None
    mu: MuOption = DEFAULT_MU
    mu_torsion: Annotated[
        float | None, option("Soft contacts with this torsional friction, m.", "M", GRIP)
    ] = None
    grip_force: Annotated[float | None, option("Least normal force of a finger, N.", "N", GRIP)] = (
        None
    )
    expect_load: Annotated[
        str | None, option("Grip for a load in any direction: N or N,Nm.", "LOAD", GRIP)
    ] = None
    joint_error: JointErrorOption = None
    cloud_error: Annotated[
        str, option("How far a cloud may be off: 5mm,5 (degrees).", "ERROR", GRIP)
    ] = "0"
    base: Annotated[str | None, option("Fixed pose of the hand's base, as --at.", "POSE", GRIP)] = (
        None
    )
    wrist: Annotated[
        str | None, option("free, or where its joints are held, degrees.", "ANGLES", GRIP)
    ] = None

    def task(self, hand: Hand | str, object: str) -> GraspTask:
        """The task with a hand, or its name or path, and an object as ``parse_object`` takes it.

        Raises:
            PlannerError: An unknown name, or something that cannot be.
        """
        from planner.hand_loading import load_hand
        from planner.task import GraspTask

        loaded = load_hand(hand) if isinstance(hand, str) else hand
        item = object_of(object, **self.told_of_object())
        height = table_of(self.table)
        told = self.told_of_grasp(loaded)
        if self.stand:
            told |= {"obstacles": ()}
        task = GraspTask.create(
            loaded,
            item,
            T_world_object=self._object_pose(item, height),
            table_height=height,
            **told,
        )
        if not self.stand:
            return task
        from planner.motion.manipulation import on_stand
        from sim.manipulation import settled

        task = settled(on_stand(task, self.stand))
        return replace(task, obstacles=(*task.obstacles, *self._obstacles()))

    def told_of_grasp(self, hand: Hand) -> dict[str, Any]:
        """What is told beside object and table: arguments of ``GraspTask.create``."""
        return {
            "obstacles": self._obstacles(),
            "gravity": numbers("--gravity", self.gravity, 3),
            "mu": self.mu,
            "mu_torsion": self.mu_torsion or 0.0,
            "contact_model": "point" if self.mu_torsion is None else "soft",
            "fingers": None if self.fingers is None else names(self.fingers),
            "grasp_type": self.type,
            "grip_force": self.grip_force,
            "expected_load": self._load(),
            "joint_error": math.radians(self.joint_error or 0.0),
            "T_world_base": None if self.base is None else pose_of("--base", self.base),
            **self._wrist(hand),
        }

    def _obstacles(self) -> tuple[Obstacle, ...]:
        return tuple(obstacle_of(text, k) for k, text in enumerate(self.obstacle or (), 1))

    def told_of_object(self) -> dict[str, Any]:
        """What is told of the object beside its name: arguments of ``parse_object``."""
        return {
            "mass": self.mass,
            "density": self.density,
            "repair": self.repair,
            "strict": self.strict,
            "touch": self._touch_region(),
        }

    def _object_pose(self, item: GraspObject, table: float | None) -> SE3:
        """Where the object is, by ``--at``, ``--pose`` and the table's height (m)."""
        from planner.errors import TaskError
        from planner.spatial import SE3

        standing = item.resting_pose(0.0 if table is None else table, self.pose)
        if self.at is None:
            return standing
        count = self.at.count(",") + 1
        if count == POSE:
            if self.pose:
                raise TaskError(
                    f"--at {self.at!r} tells how the object is turned, and so does --pose "
                    f"{self.pose}; give x,y or x,y,z, or leave --pose out"
                )
            return pose_of("--at", self.at)
        if count not in (PLACE, POSITION):
            raise TaskError(
                f"--at {self.at!r} has {count} numbers; give x,y for where it stands, x,y,z for "
                "its centre of mass, or x,y,z,roll,pitch,yaw; m and degrees"
            )
        place = standing.translation.copy()
        place[:count] = numbers("--at", self.at, count)
        return SE3(standing.rotation, place)

    def _wrist(self, hand: Hand) -> dict[str, Any]:
        """Arguments of a task that say what the wrist does.

        Raises:
            TaskError: Not as many angles as the wrist has joints.
        """
        from planner.errors import TaskError

        if self.wrist is None:
            return {}
        if self.wrist.strip().lower() == "free":
            return {"wrist_free": True}
        joints = hand.description.wrist_joints
        count = self.wrist.count(",") + 1
        if count != len(joints):
            raise TaskError(
                f"--wrist {self.wrist!r} gives {count} angle(s), and the wrist of {hand.name} has "
                f"{len(joints)} joint(s): {', '.join(joints) or 'none'}; give as many degrees, or "
                "free"
            )
        return {"wrist_q": [math.radians(v) for v in numbers("--wrist", self.wrist, count)]}

    def _touch_region(self) -> TouchRegion | None:
        from planner.objects import TouchRegion, parse_region

        if not self.touch and not self.avoid:
            return None
        return TouchRegion(
            allowed=tuple(parse_region(text) for text in self.touch or ()),
            forbidden=tuple(parse_region(text) for text in self.avoid or ()),
        )

    def _load(self) -> ExpectedLoad | None:
        from planner.forces import ExpectedLoad

        if self.expect_load is None:
            return None
        count = 2 if "," in self.expect_load else 1
        force, torque = (*numbers("--expect-load", self.expect_load, count), 0.0)[:2]
        return ExpectedLoad(force=force, torque=torque)
