"""A hand that an arm carries: the arm's joints are unknowns of the same programme.

Plans a grasp with the Allegro-type hand on a 7-axis arm, prints the arm's joints before, at and
after the grasp, executes it by the arm's own servos, and shows what happens where the arm cannot
reach.
"""

from __future__ import annotations

import numpy as np

from planner import SE3, GraspTask, plan_grasp
from planner.errors import TaskError
from sim.trial import simulate

HAND = "allegro_on_arm7"
OBJECT = "cylinder:0.03x0.10"
OUT_OF_REACH = 2.0  # m
SEED = 0

task = GraspTask.create(HAND, OBJECT)
plan = plan_grasp(task, seed=SEED)
hand = task.hand
print(f"found at attempt {plan.record.attempts}: {len(hand.arm_index)} joints of the arm, rad")
for what, q in (("start", plan.q_start), ("grasp", plan.q)):
    print(f"{what}: {np.round(q[hand.arm_index], 3).tolist()}")

report = simulate(plan)
verdict = "held" if report.success else f"not held: {report.reason}"
print(f"carried by the {report.carried_by}: {verdict}; it slipped {report.largest_slip[0]:.1f} mm")

far = SE3(np.eye(3), task.T_world_object.translation + np.array([OUT_OF_REACH, 0.0, 0.0]))
try:
    base = task.T_world_base
    plan_grasp(GraspTask.create(HAND, OBJECT, T_world_object=far, T_world_base=base))
except TaskError as error:
    print(f"TaskError: {error}")
