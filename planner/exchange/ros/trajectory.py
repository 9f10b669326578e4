"""``ros2-trajectory``: plans and movements as trajectory_msgs/JointTrajectory, by joint name.

Grasp plans, motions, gaits and manipulation plans all have a ``joint_trajectory``; what the base of
a hand without an arm does meanwhile is not in the message.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from planner.exchange.formats import GraspFormat, Writing, register_format
from planner.exchange.joints import channels_of
from planner.exchange.ros.parts import joint_trajectory, write_messages
from planner.exchange.sources import AnyPlan, task_of_plan
from planner.version import written_by

TRAJECTORY = "trajectory_msgs/JointTrajectory"


def trajectory_message(plan: AnyPlan, writing: Writing | None = None) -> dict[str, Any]:
    """A plan as plain data of trajectory_msgs/JointTrajectory.

    Args:
        plan: Of any kind.
        writing: Names of joints; ours if None.

    Raises:
        NotFoundError: ``writing`` renames what is not there.
        TaskError: Two joints would have one name.
    """
    way = plan.joint_trajectory()
    channels = channels_of(task_of_plan(plan).hand, writing or Writing())
    return joint_trajectory(channels.names, way.times.tolist(), channels.values(way.positions))


def write_ros_trajectories(
    plans: Sequence[AnyPlan], path: Path, writing: Writing
) -> tuple[Path, ...]:
    """Write plans as messages of trajectory_msgs/JointTrajectory.

    Raises:
        NotFoundError: ``writing`` renames what is not there.
        TaskError: Two joints would have one name.
        FileFormatError: The file cannot be written.
    """
    hand = task_of_plan(plans[0]).hand
    comments = (
        f"{written_by()}: {TRAJECTORY} of {hand.name}; rad, m",
        *channels_of(hand, writing).said,
    )
    return write_messages([trajectory_message(plan, writing) for plan in plans], path, comments)


ROS_TRAJECTORY = register_format(
    GraspFormat(
        name="ros2-trajectory",
        title=f"{TRAJECTORY} of ROS 2 as YAML, a document per plan, or a list as JSON",
        suffixes=(".yaml", ".yml", ".json"),
        loses=(
            "all but joint positions over time: the pose of a hand without an arm, phases, "
            "contacts and forces, the object"
        ),
        recognises=lambda path: False,
        write=write_ros_trajectories,
        heeds=frozenset({"rename", "by"}),
        movements=True,
    )
)
