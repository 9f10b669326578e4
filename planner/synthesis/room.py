"""Room for joints that are not where their encoders say, and above the table beside low parts.

Called by the searches for grasps and motions with a task whose ``joint_error`` is above 0. They
solve with the room first; where that fails they go on from there without it, so that a plan has
room where there is some and is found where there is none.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from planner.kinematics.state import tip_reach
from planner.shapes import Mesh
from planner.synthesis.options import SynthesisOptions
from planner.task import GraspTask
from planner.tolerances import EDGE_RADIUS

ROOM_DEVIATIONS, TABLE_DEVIATIONS = 1.0, 2.0
"""Standard deviations of a fingertip's place that the room between fingers and of links from the
object has, and that above table and obstacles (-). A tip that comes down on the table ends a trial:
of 17 holds of the Shadow-type hand under ``rough`` 9 succeeded with one, and 13 with two
(development draws). A link that came down on the object's rim was found in six of six failed
turns that were taken apart (development draws)."""


def with_room(options: SynthesisOptions, task: GraspTask) -> SynthesisOptions:
    """The options with more distance of links from the object, between fingers and from the table.

    More by ``ROOM_DEVIATIONS`` and ``TABLE_DEVIATIONS`` x ``task.joint_error`` x ``tip_reach``. The
    same options if the joints have no error.
    """
    deviation = task.joint_error * tip_reach(task.hand)
    if deviation == 0.0:
        return options
    return replace(
        options,
        clear_object=options.clear_object + ROOM_DEVIATIONS * deviation,
        clear_fingers=options.clear_fingers + ROOM_DEVIATIONS * deviation,
        clear_table=options.clear_table + TABLE_DEVIATIONS * deviation,
    )


LEAST_ROOM = 0.0007
"""Distance (m) from the table that is asked beside the lowest parts: that of ``clear_tip``."""


@lru_cache(maxsize=8)
def table_room(task: GraspTask) -> float:
    """Distance (m) of links from the table that a narrow object's height leaves; else infinite.

    A round pad of radius r touches a level face at least r above the table, and less than
    ``EDGE_RADIUS`` below the top it is on an edge: half of what is left between goes to the table.
    """
    shape = task.object.shape
    if task.table_height is None or not (isinstance(shape, Mesh) and shape.narrow):
        return np.inf
    up = task.T_world_object.rotation[2]
    top = task.T_world_object.translation[2] + shape.support(up)
    radius = max(f.pad.radius for f in task.fingers)
    return float(max(LEAST_ROOM, (top - task.table_height - EDGE_RADIUS - radius) / 2))
