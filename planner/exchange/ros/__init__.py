"""Contents of ROS 2 messages as YAML or JSON, made and read without ROS.

Field names and types are those of https://github.com/moveit/moveit_msgs, branch ros2, at commit
ec3ba4b (2024-10-17), ``msg/Grasp.msg`` and ``msg/GripperTranslation.msg``;
https://github.com/ros2/common_interfaces at commit c0c0bc5 (2024-11-27), ``trajectory_msgs``,
``geometry_msgs`` and ``std_msgs``; https://github.com/ros2/rcl_interfaces at commit f6b3741,
``builtin_interfaces``.
What a text becomes in a message is up to ``rosidl_runtime_py.set_message_fields``
(https://github.com/ros2/rosidl_runtime_py at commit 3327b1d), by which ``ros2 topic pub`` reads
YAML: names are those of the fields, unknown ones are refused, missing ones keep their defaults.

A YAML file has a document per message, a JSON file a list of messages.
"""

from planner.exchange.ros.grasp import (
    grasp_message,
    read_ros_grasps,
    trajectory_message,
    write_ros_grasps,
    write_ros_trajectories,
)
from planner.exchange.ros.messages import FIELDS, check_message

__all__ = [
    "FIELDS",
    "check_message",
    "grasp_message",
    "read_ros_grasps",
    "trajectory_message",
    "write_ros_grasps",
    "write_ros_trajectories",
]
