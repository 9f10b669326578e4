"""Summaries on the terminal say the numbers of the plan."""

from __future__ import annotations

import re

from planner.objects import parse_object
from planner.search.grasp import plan_grasp
from planner.task import GraspTask


def test_the_table_of_a_plan_has_each_finger_with_its_place_and_force() -> None:
    plan = plan_grasp(GraspTask.create("allegro_hand", parse_object("sphere", mass=0.2)))
    text = str(plan)
    assert "allegro_hand grasps sphere" in text and "(200 g)" in text
    assert f"epsilon {plan.quality.epsilon:.4f}" in text
    local = plan.contacts.transformed(plan.task.T_world_object.inverse())
    for k, finger in enumerate(plan.task.finger_names):
        row = next(line for line in text.splitlines() if finger in line)
        numbers = [float(word) for word in re.findall(r"-?\d+\.\d+", row)]
        expected = [*(1e3 * local.positions[k]), plan.contacts.forces[k, 0]]
        assert all(abs(a - b) < 0.051 for a, b in zip(numbers, expected, strict=False)), row
