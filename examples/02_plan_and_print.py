"""Describe a task of your own, plan a grasp, read its residuals, export it for a real hand.

The object stands on a low table, turned about the vertical, with a wall beside it. Prints the plan
with what was recomputed on the true geometry, and writes the joint trajectory (times, joints by
name, base pose) to joint_trajectory.csv in the current folder. Prints "found", four contacts with
gaps far below 0.5 mm, and the name of the nearest other pair of bodies.
"""

from __future__ import annotations

import numpy as np

from planner import SE3, GraspTask, NoGraspFoundError, Obstacle, parse_object, plan_grasp
from planner.files import write_trajectory

HAND = "allegro_hand"
OBJECT = "box:0.05x0.05x0.08"  # full lengths, m
MASS = 0.15  # kg
TABLE_HEIGHT = 0.30  # m
TURN = np.deg2rad(30.0)  # of the object about the vertical, rad
WALL = (0.02, 0.30, 0.12)  # full lengths, m
WALL_DISTANCE = 0.10  # of the wall's centre from the object's, m
MU = 0.5  # sliding friction that planning may rely on (-)
SEED = 0
MAX_ATTEMPTS = 30
MAX_CPU_S = 20.0  # s, looked at between attempts
RATE_HZ = 50.0  # samples of the exported trajectory per second

c, s = np.cos(TURN), np.sin(TURN)
turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
item = parse_object(OBJECT, mass=MASS)
height = TABLE_HEIGHT + item.shape.half_extents[2]
task = GraspTask.create(
    HAND,
    item,
    T_world_object=SE3(turn, np.array([0.4, 0.1, height])),
    table_height=TABLE_HEIGHT,
    obstacles=(
        Obstacle(
            name="wall",
            size=np.array(WALL),
            T_world_obstacle=SE3(
                np.eye(3), np.array([0.4 + WALL_DISTANCE, 0.1, TABLE_HEIGHT + WALL[2] / 2])
            ),
        ),
    ),
    mu=MU,
)
try:
    plan = plan_grasp(task, seed=SEED, max_attempts=MAX_ATTEMPTS, max_cpu_s=MAX_CPU_S)
except NoGraspFoundError as error:  # it carries every attempt with its reason
    raise SystemExit(str(error)) from None

record = plan.record
print(f"found at attempt {record.attempts} of at most {MAX_ATTEMPTS}, {record.cpu_s:.2f} s of CPU")
print("\nfinger   contact in the object (mm)   pad gap (um)   normal force (N)   friction used (%)")
for name, point, gap, force, used in zip(
    plan.contacts.fingers,
    plan.contacts_in_object.positions,
    plan.verification.pad_gaps,
    plan.forces.forces,
    plan.forces.contacts.friction_utilisation(),
    strict=True,
):
    x, y, z = 1e3 * point
    print(
        f"{name:8} {x:8.1f} {y:8.1f} {z:8.1f} {1e6 * gap:14.2f} {force[0]:18.2f} {100 * used:19.0f}"
    )
print(f"\nforces miss the weight by at most {np.abs(plan.forces.residuals.wrench[:3]).max():.1e} N")
print(f"{plan.quality.closure.reason}; epsilon {plan.quality.epsilon:.3f}")
for clearance in plan.verification.closest[:3]:
    print(f"clear by {1e3 * clearance.distance:.1f} mm: {clearance.first} - {clearance.second}")

trajectory = plan.joint_trajectory(rate_hz=RATE_HZ)
write_trajectory(trajectory, "joint_trajectory.csv")
n, last = len(trajectory.times), trajectory.times[-1]
print(f"\njoint_trajectory.csv: {n} rows over {last:.1f} s, {len(trajectory.joint_names)} joints")
