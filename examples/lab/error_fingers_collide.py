"""The lab's error "fingers collide with each other", seen before and during execution.

The lab's remedy is to add collision avoidance. Two postures are compared: the planner's grasp, in
which all links keep a distance by the planning itself, and the same with two fingers moved towards
each other on purpose. Prints the smallest signed distances between links by name, by coal, before
anything moves (negative is penetration). Then both are executed, and the verdict names the links
that met, with their force. So what the planner says of a posture is what MuJoCo finds.
"""

from __future__ import annotations

import numpy as np

from planner import GraspPlan, GraspTask, plan_grasp
from planner.collision.world import CollisionWorld
from planner.spatial import FloatArray
from sim.controllers import GraspController, Observation
from sim.trial import Timeline, simulate

HAND = "shadow_hand"
OBJECT = "box"
CROSSING = {"FFJ4": 0.34, "MFJ4": -0.34}  # sideways joints of two fingers, rad
COUNT = 3  # pairs that are printed
QUICK = Timeline(approach=0.5, close=0.5, squeeze=0.3, settle=0.1, lift=0.2, hold=0.2)


class Crossing:
    """Moves the fingers from the pre-grasp to a posture, and presses on."""

    def __init__(self, plan: GraspPlan, q: FloatArray) -> None:
        """Keep them."""
        self.plan, self.q = plan, q

    def step(self, observation: Observation) -> FloatArray:
        """Commands (nu,) that would be at rest on the way."""
        share = 0.0 if observation.phase == "approach" else 1.0
        if observation.phase == "close":
            share = observation.progress
        q = self.plan.q_pregrasp + share * (self.q - self.plan.q_pregrasp)
        still = np.zeros(len(q))
        ctrl, _ = self.plan.task.hand.actuation.ctrl_for_torque(q, still, still)
        return ctrl


plan = plan_grasp(GraspTask.create(HAND, OBJECT), seed=0)
hand = plan.task.hand
crossed = plan.q.copy()
for joint, angle in CROSSING.items():
    crossed[hand.joint_index(joint)] = angle
world = CollisionWorld(plan.task)
pads = [finger.pad.geom for finger in plan.task.fingers]
for title, q, controller in (
    ("as planned", plan.q, GraspController(plan)),
    ("crossed on purpose", crossed, Crossing(plan, crossed)),
):
    closest = world.closest(plan.T_world_base, q, COUNT, may_touch=pads)[:COUNT]
    report = simulate(plan, controller=controller, timeline=QUICK)
    print(title)
    print("  nearest by planning:", "; ".join(str(pair) for pair in closest))
    print(f"  executed: {'held' if report.success else report.reason}", report.verdict.detail)
    print(f"  links press on each other by up to {report.samples.collision_N.max():.1f} N")
