"""Poses of a plan in frames that others know, and what a format refuses.

Others know an object by its file, so that poses are written in the frame of that file; our own
frame has its origin at the centre of mass. What is not from a file keeps our frame.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from planner.errors import NotFoundError, TaskError
from planner.exchange.dexgraspbench.object_files import frame_shift
from planner.exchange.formats import Writing
from planner.hands.hand import Hand
from planner.kinematics.state import HandState
from planner.plan import GraspPlan
from planner.spatial import SE3, FloatArray
from planner.task import GraspTask


def T_file_object(task: GraspTask) -> SE3:
    """Pose of our frame of a task's object in the frame of the object's own file."""
    return SE3(np.eye(3), frame_shift(task.object.shape))


def T_base_body(hand: Hand, q: FloatArray, body: str) -> SE3:
    """Pose of a body of a hand in its base, at joints (nq,); of the base itself for "".

    Raises:
        NotFoundError: The hand has no such body.
    """
    if body in ("", hand.description.base_body):
        return SE3.Identity()
    bodies = [f.name for f in hand.pin_model.frames if f.type == pin.FrameType.BODY]
    if body not in bodies:
        raise NotFoundError(f"body of {hand.name}", body, bodies)
    return SE3(HandState(hand, q).pin_data.oMf[hand.pin_model.getBodyId(body)])


def T_object_body(plan: GraspPlan, body: str = "") -> SE3:
    """Pose of a body of the hand at the grasp, in the frame of the object's own file.

    Raises:
        NotFoundError: The hand has no such body.
    """
    task = plan.task
    T_object_base = task.T_world_object.inverse() * plan.T_world_base
    return T_file_object(task) * T_object_base * T_base_body(task.hand, plan.q, body)


def object_frame(task: GraspTask, writing: Writing) -> str:
    """Name of the object's frame in a file."""
    return writing.object_frame or task.object.name


def hand_frame(hand: Hand, writing: Writing) -> str:
    """Name of the hand's frame in a file."""
    return writing.hand_frame or writing.base_body or hand.description.base_body


def need_no_arm(task: GraspTask, what: str) -> Hand:
    """The hand of a task.

    Raises:
        TaskError: It is on an arm.
    """
    if task.hand.arm is not None:
        raise TaskError(
            f"{task.hand.name} is on an arm, and {what} tells the pose of a hand alone; plan with "
            "the hand without its arm, or export ros2-trajectory"
        )
    return task.hand


def need_one_pair(plans: Sequence[GraspPlan], what: str) -> GraspTask:
    """A task that all plans share as far as hand and object go.

    Raises:
        TaskError: They are of several hands or objects.
    """
    first = plans[0].task
    for plan in plans[1:]:
        task = plan.task
        for kind, mine, other, same in (
            ("hand", first.hand.name, task.hand.name, first.hand.digest == task.hand.digest),
            ("object", first.object.name, task.object.name, _same_object(first, task)),
        ):
            if not same:
                raise TaskError(
                    f"the plans are for more than one {kind}, {mine} and {other}, and a file of "
                    f"{what} is for one; write a file for each"
                )
    return first


def _same_object(one: GraspTask, other: GraspTask) -> bool:
    a, b = one.object, other.object
    return a is b or (a.name, a.shape.spec) == (b.name, b.shape.spec)
