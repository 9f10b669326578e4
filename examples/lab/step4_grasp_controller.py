"""The lab's step 4: a controller that approaches with all fingers and then squeezes.

The lab squeezes from every fingertip towards the object's centre. Such forces do not cancel, and
what is left over pushes the object away. Forces that cancel come from a quadratic programme, with
the friction cones as limits and the weight as load. Prints for both what is left over once they
carry the weight, and how much of the cones they use (above 100 % a finger slips). Then both
squeeze in MuJoCo after the same approach, with torques that go through the laws of servos and
tendons; for each phase the normal forces, and how far the object has moved on the table and, in
the hold, in the hand. The lab's squeeze loses it, ours moves it by less than 0.1 mm.
"""

from __future__ import annotations

import numpy as np

from planner import GraspPlan, GraspTask, HandState, distribute_forces, plan_grasp
from planner.forces import gravity_wrench
from planner.spatial import FloatArray
from sim.controllers import Controller, GraspController, Observation
from sim.trial import Timeline, simulate

HAND = "shadow_hand"
OBJECT = "box"
SQUEEZE = 2.0  # force of each finger, N, as in the lab


class TowardsCentre:
    """Approaches as ours does, and then squeezes as the lab does."""

    def __init__(self, plan: GraspPlan) -> None:
        """Prepare the approach."""
        self.plan, self.approach = plan, GraspController(plan)

    def step(self, observation: Observation) -> FloatArray:
        """Commands (nu,)."""
        if observation.phase in ("approach", "close"):
            return self.approach.step(observation)
        hand, base = self.plan.task.hand, observation.T_world_base
        state = HandState(hand, observation.q)
        torque = state.gravity_torque(base.rotation.T @ self.plan.task.gravity)
        center = base.actInv(observation.T_world_object.translation)
        for finger in self.plan.task.fingers:
            inward = center - state.tip_pose(finger).translation
            push = SQUEEZE * inward / np.linalg.norm(inward)
            torque[finger.q_index] += state.tip_jacobian(finger)[:3].T @ push
        ctrl, _ = hand.actuation.ctrl_for_torque(observation.q, observation.v, torque)
        return ctrl


plan = plan_grasp(GraspTask.create(HAND, OBJECT), seed=0)
weight = gravity_wrench(plan.task.object.mass, plan.task.gravity)
inward = plan.contacts.center - plan.contacts.positions
inward *= SQUEEZE / np.linalg.norm(inward, axis=1, keepdims=True)
along = np.einsum("nji,nj->ni", plan.contacts.frames, inward)
lab = plan.contacts.with_forces(np.column_stack([along, np.zeros(len(along))]))
found = distribute_forces(plan.contacts, wrench=weight, min_normal=SQUEEZE).raise_if_infeasible()
for title, contacts in (("towards the centre", lab), ("internal forces", found.contacts)):
    left = np.linalg.norm((contacts.wrench() + weight)[:3])
    used = 100 * contacts.friction_utilisation().max()
    print(f"{title:18}: {left:.3f} N are left over, up to {used:.0f} % of a friction cone is used")

quick = Timeline.quick()
controllers: dict[str, Controller] = {
    "the lab's squeeze": TowardsCentre(plan),
    "ours": GraspController(plan),
}
for title, controller in controllers.items():
    report = simulate(plan, controller=controller, timeline=quick)
    print(f"\n{title}: {'held' if report.success else 'not held'} {report.verdict.detail}")
    for phase in ("close", "squeeze", "settle", "hold"):
        last = report.samples.during(phase)[-1]
        forces = np.round(report.samples.normal_force[last], 1)
        slip = report.samples.slip_mm[last] if phase == "hold" else report.samples.moved_mm[last]
        print(f"  {phase:7} normal forces {forces} N, the object moved by {slip:.1f} mm")
