"""Send a planned grasp to ROS 2: moveit_msgs/Grasp and trajectory_msgs/JointTrajectory.

Publishes both once, latched, and ends. Without ROS it says what is missing, and prints what it
would send. ``opposable export`` writes the same contents to files.
"""

from __future__ import annotations

import sys
from importlib import import_module
from importlib.util import find_spec

from planner import GraspTask, plan_grasp
from planner.exchange import Writing
from planner.exchange.ros import grasp_message, trajectory_message

TOPICS = {"grasp": "moveit_msgs/msg/Grasp", "trajectory": "trajectory_msgs/msg/JointTrajectory"}
NAMES = Writing(world_frame="world", rename={"thumb_0": "joint_12"})  # as the driver has them
WAIT = 2.0  # s, for who listens to fetch them

plan = plan_grasp(GraspTask.create("allegro_hand", "box"), seed=0)
contents = {
    "grasp": grasp_message(plan, "grasp_0", NAMES),
    "trajectory": trajectory_message(plan, NAMES),
}
needed = ("rclpy", "rosidl_runtime_py", "moveit_msgs", "trajectory_msgs")
if missing := [name for name in needed if find_spec(name) is None]:
    print(f"nothing is sent: ROS 2 lacks {', '.join(missing)}; source its setup file first")
    pose = contents["grasp"]["grasp_pose"]
    print(f"{TOPICS['grasp']}: pose in {pose['header']['frame_id']} at {pose['pose']['position']}")
    joints, points = contents["trajectory"]["joint_names"], contents["trajectory"]["points"]
    print(f"{TOPICS['trajectory']}: {len(points)} points of {len(joints)} joints: {joints}")
    sys.exit()

rclpy, qos = import_module("rclpy"), import_module("rclpy.qos")
set_message_fields = import_module("rosidl_runtime_py").set_message_fields
get_message = import_module("rosidl_runtime_py.utilities").get_message

rclpy.init()
node = rclpy.create_node("opposable")
latched = qos.QoSProfile(depth=1, durability=qos.DurabilityPolicy.TRANSIENT_LOCAL)
publishers = []
for topic, kind in TOPICS.items():
    message = get_message(kind)()
    set_message_fields(message, contents[topic])
    publishers.append(node.create_publisher(type(message), topic, latched))
    publishers[-1].publish(message)
rclpy.spin_once(node, timeout_sec=WAIT)
rclpy.shutdown()
