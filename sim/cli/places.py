"""Objects, poses, obstacles and heights as the command line writes them: metres, and degrees."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from rich.markup import escape

from sim.cli.common import err, numbers, say

if TYPE_CHECKING:
    from planner.objects import GraspObject
    from planner.spatial import SE3
    from planner.task import Obstacle

POSE_FORM = "x,y,z or x,y,z,roll,pitch,yaw"
"""How a pose is written: m in the world, and degrees about the world's fixed axes x, y, z."""

OBSTACLE_FORM = "box:XxYxZ@x,y,z or box:XxYxZ@x,y,z,roll,pitch,yaw"
"""How an obstacle is written: full extents and pose of its centre."""

POSITION, POSE = 3, 6
"""Numbers of a position, and of a pose."""


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
