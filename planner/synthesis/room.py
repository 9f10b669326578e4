"""Room for joints that are not where their encoders say: how much, and options that ask for it.

Called by the searches for grasps and motions with a task whose ``joint_error`` is above 0. They
solve with the room first; where that fails they go on from there without it, so that a plan has
room where there is some and is found where there is none.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from planner.hands.hand import Hand
from planner.kinematics.state import HandState
from planner.synthesis.options import SynthesisOptions
from planner.task import GraspTask

ROOM_DEVIATIONS = 1.0
"""Standard deviations of a fingertip's place that the room has (-)."""


def with_room(options: SynthesisOptions, task: GraspTask) -> SynthesisOptions:
    """The options with more distance between fingers and from table and obstacles.

    More by ``ROOM_DEVIATIONS`` x ``task.joint_error`` x ``tip_reach``. The same options if the
    joints have no error.
    """
    room = ROOM_DEVIATIONS * task.joint_error * tip_reach(task.hand)
    if room == 0.0:
        return options
    return replace(
        options,
        clear_fingers=options.clear_fingers + room,
        clear_table=options.clear_table + room,
    )


@lru_cache(maxsize=8)
def tip_reach(hand: Hand) -> float:
    """How far (m/rad) a pad moves if all joints of its finger are off: the worst finger's.

    If errors of the joints are independent, each of standard deviation s, the place of a pad has
    the covariance s^2 J J^T; s times the largest singular value of J is its standard deviation in
    its worst direction. J (3, n) is taken in the middle of the joints' ranges.
    """
    state = HandState(hand, (hand.q_lower + hand.q_upper) / 2.0)
    reach = 0.0
    for finger in hand.fingers.values():
        jacobian = state.point_jacobian(finger.pad.joint_id, state.pad_center(finger))[:3]
        reach = max(reach, float(np.linalg.norm(jacobian[:, finger.q_index], 2)))
    return reach
