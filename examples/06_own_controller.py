"""Let your own controller drive the hand in a trial, and compare it with the one that comes along.

A controller is any object with ``step(observation) -> ctrl``: one command per actuator, in the
order of ``hand.actuation.names``. Two are written here. One moves the servos to the planned
posture and knows nothing of forces; the other takes the planned forces and grips harder as soon as
the object moves in the hand. Prints, for slippery contacts, the verdict, the slip and the force of
each. The servos touch as planned but do not press, so they leave the object on the table, which a
report calls dropped; the tighter grip slips less than the planned one.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from planner import GraspPlan, GraspTask, plan_grasp
from planner.spatial import FloatArray
from sim.controllers import Controller, GraspController, Observation
from sim.scene.physics import PhysicsOptions
from sim.trial import Timeline, simulate

HAND = "allegro_hand"
OBJECT = "sphere"
SEED = 0
MU = 0.4  # sliding friction in simulation (-): less than the 0.5 that planning relied on
HOLD = 1.0  # duration of the last phase, s
MAX_GRIP = 2.0  # at most this many times the planned forces (-)
SLIP_FULL_GRIP = 0.5e-3  # movement of the object in the hand that asks for all of it, m


class PostureServo:
    """Moves every actuator to the planned posture, and on to hold against gravity at rest."""

    def __init__(self, plan: GraspPlan) -> None:
        """Keep the plan."""
        self.plan = plan

    def step(self, observation: Observation) -> FloatArray:
        """Commands (nu,) that would be at rest at the wanted posture."""
        share = 0.0 if observation.phase == "approach" else 1.0
        if observation.phase == "close":
            share = observation.progress
        q = self.plan.q_pregrasp + share * (self.plan.q - self.plan.q_pregrasp)
        still = np.zeros(len(q))
        ctrl, _ = self.plan.task.hand.actuation.ctrl_for_torque(q, still, still)
        return ctrl


class TighterGrip:
    """A ``GraspController`` whose forces grow when the object moves in the hand.

    While no actuator is at its limit, commands are an affine function of the planned forces, so
    those for the planned forces and those for a multiple of them can be mixed.
    """

    def __init__(self, plan: GraspPlan) -> None:
        """Make one controller for the planned forces and one for ``MAX_GRIP`` times them."""
        hard = plan.contacts.with_forces(MAX_GRIP * plan.contacts.forces)
        self.soft = GraspController(plan)
        self.hard = GraspController(replace(plan, contacts=hard))
        self.reference: FloatArray | None = None
        self.share = 0.0

    def step(self, observation: Observation) -> FloatArray:
        """Commands (nu,) between the two, by how far the object has moved in the hand."""
        soft, hard = self.soft.step(observation), self.hard.step(observation)
        in_hand = observation.T_world_base.actInv(observation.T_world_object.translation)
        if observation.phase in ("settle", "lift", "hold"):
            if self.reference is None:
                self.reference = in_hand
            slip = float(np.linalg.norm(in_hand - self.reference))
            self.share = max(self.share, min(1.0, slip / SLIP_FULL_GRIP))
        return np.asarray((1.0 - self.share) * soft + self.share * hard)


plan = plan_grasp(GraspTask.create(HAND, OBJECT), seed=SEED)
controllers: dict[str, Controller] = {
    "GraspController": GraspController(plan),
    "PostureServo": PostureServo(plan),
    "TighterGrip": TighterGrip(plan),
}
print(f"{HAND}, {OBJECT}, planned for mu {plan.task.mu}, simulated with mu {MU}\n")
print("controller        verdict        slip (mm)   turn (deg)   normal forces at the end (N)")
for name, controller in controllers.items():
    report = simulate(
        plan,
        physics=PhysicsOptions(mu=MU),
        controller=controller,
        timeline=Timeline(hold=HOLD),
    )
    moved, turned = report.largest_slip
    forces = np.round(report.samples.normal_force[-1], 2)
    print(f"{name:17} {report.reason or 'held':12} {moved:11.2f} {turned:12.2f}   {forces}")
