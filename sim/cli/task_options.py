"""Options that say what is to be grasped, where, by which fingers: those of a ``GraspTask``."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sim.cli.common import (
    GRIP_PANEL,
    SCENE_PANEL,
    AvoidOption,
    FingersOption,
    JointErrorOption,
    MassOption,
    MuOption,
    RepairOption,
    StandOption,
    StrictOption,
    TouchOption,
    names,
    numbers,
)
from sim.cli.places import object_of, obstacle_of, pose_of, table_of

if TYPE_CHECKING:
    from planner.forces import ExpectedLoad
    from planner.hands.hand import Hand
    from planner.objects import GraspObject, TouchRegion
    from planner.spatial import SE3
    from planner.task import GraspTask

PLACE, POSITION, POSE = 2, 3, 6
"""Numbers of ``--at``: a place on the table, a position, a pose."""

GRAVITY = "0,0,-9.81"
"""Gravity if nothing is said, m/s2, world."""


def _refuse_swapped(hand: str, object: str) -> None:
    """Say so where the object stands before the hand.

    Raises:
        TaskError: It does.
    """
    from planner.errors import TaskError
    from planner.hands.catalog import foreign_hand_names, hand_names
    from planner.objects import object_names

    if hand.split(":")[0] in object_names() and object in (*hand_names(), *foreign_hand_names()):
        raise TaskError(
            f"{hand!r} is an object and {object!r} a hand; the hand comes first: {object} {hand}"
        )


@dataclass(frozen=True, kw_only=True)
class TaskOptions:
    """What ``run``, ``plan`` and ``batch`` are told of object, surroundings and hand."""

    pose: Annotated[
        int,
        typer.Option(
            min=0,
            help="Which of its stable poses it stands in.",
            metavar="N",
            rich_help_panel=SCENE_PANEL,
        ),
    ] = 0
    at: Annotated[
        str | None,
        typer.Option(
            help="x,y where it stands, or x,y,z of its centre, m[,roll,pitch,yaw, degrees].",
            metavar="POSE",
            rich_help_panel=SCENE_PANEL,
        ),
    ] = None
    mass: MassOption = None
    density: Annotated[
        float | None,
        typer.Option(
            help="kg/m3, instead of its mass.", metavar="RHO", rich_help_panel=SCENE_PANEL
        ),
    ] = None
    repair: RepairOption = False
    strict: StrictOption = False
    touch: TouchOption = None
    avoid: AvoidOption = None
    table: Annotated[
        str,
        typer.Option(
            help="Height of the table's top, m, or none.",
            metavar="Z|none",
            rich_help_panel=SCENE_PANEL,
        ),
    ] = "0"
    stand: StandOption = 0.0
    obstacle: Annotated[
        list[str] | None,
        typer.Option(
            help="Fixed box:XxYxZ@POSE; repeatable.",
            metavar="BOX",
            rich_help_panel=SCENE_PANEL,
        ),
    ] = None
    gravity: Annotated[
        str, typer.Option(help="In m/s2.", metavar="X,Y,Z", rich_help_panel=SCENE_PANEL)
    ] = GRAVITY
    fingers: FingersOption = None
    mu: MuOption = 0.5
    mu_torsion: Annotated[
        float | None,
        typer.Option(
            help="Soft contacts with this torsional friction, m.",
            metavar="M",
            rich_help_panel=GRIP_PANEL,
        ),
    ] = None
    grip_force: Annotated[
        float | None,
        typer.Option(
            help="Least normal force of a finger, N.", metavar="N", rich_help_panel=GRIP_PANEL
        ),
    ] = None
    expect_load: Annotated[
        str | None,
        typer.Option(
            help="Grip for a load in any direction: N or N,Nm.",
            metavar="LOAD",
            rich_help_panel=GRIP_PANEL,
        ),
    ] = None
    joint_error: JointErrorOption = None
    base: Annotated[
        str | None,
        typer.Option(
            help="Fixed pose of the hand's base, as --at.",
            metavar="POSE",
            rich_help_panel=GRIP_PANEL,
        ),
    ] = None
    wrist: Annotated[
        str | None,
        typer.Option(
            help="free, or where its joints are held, degrees.",
            metavar="ANGLES",
            rich_help_panel=GRIP_PANEL,
        ),
    ] = None

    def task(self, hand: Hand | str, object: str) -> GraspTask:
        """The task with a hand, or its name or path, and an object as ``parse_object`` takes it.

        Raises:
            PlannerError: An unknown name, or something that cannot be.
        """
        from planner.hand_loading import load_hand
        from planner.motion.manipulation import on_stand
        from planner.task import GraspTask
        from sim.manipulation import settled

        if isinstance(hand, str):
            _refuse_swapped(hand, object)
        loaded = load_hand(hand) if isinstance(hand, str) else hand
        item = object_of(
            object,
            mass=self.mass,
            density=self.density,
            repair=self.repair,
            strict=self.strict,
            touch=self._touch_region(),
        )
        height = table_of(self.table)
        obstacles = tuple(obstacle_of(text, k) for k, text in enumerate(self.obstacle or (), 1))
        task = GraspTask.create(
            loaded,
            item,
            T_world_object=self._object_pose(item, height),
            table_height=height,
            obstacles=() if self.stand else obstacles,
            gravity=numbers("--gravity", self.gravity, 3),
            mu=self.mu,
            mu_torsion=self.mu_torsion or 0.0,
            contact_model="point" if self.mu_torsion is None else "soft",
            fingers=None if self.fingers is None else names(self.fingers),
            grip_force=self.grip_force,
            expected_load=self._load(),
            joint_error=math.radians(self.joint_error or 0.0),
            T_world_base=None if self.base is None else pose_of("--base", self.base),
            **self._wrist(loaded),
        )
        if not self.stand:
            return task
        task = settled(on_stand(task, self.stand))
        return replace(task, obstacles=(*task.obstacles, *obstacles))

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
