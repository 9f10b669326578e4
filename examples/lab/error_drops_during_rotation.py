"""The lab's error "object drops during rotation", what it has to do with squeezing, our diagnosis.

The lab's remedy is to squeeze harder. A planned turn is executed where it must fail: with contacts
more slippery than planned for, and with a sudden push from the side. Prints for each the phase and
reason of the failure, and what the controller noticed first: which finger slipped and how much
harder it then pressed, and which force could not be had. Last, from the plan alone: at how many
of its poses there are forces that press at least so hard with every finger and balance the
weight, within friction and the actuators' torques. Squeezing harder has an end: from 4 N on a motor
of the thumb is too weak, and what helps then is another plan, or more friction.
"""

from __future__ import annotations

import numpy as np

from planner import distribute_forces, manipulation_task, parse_object, plan_manipulation
from sim.manipulation import ManipulationTimeline, Push, manipulate
from sim.scene.physics import PhysicsOptions

HAND = "allegro_hand"
OBJECT = "cylinder:0.03x0.08"
MASS, MU = 0.1, 0.45  # kg, and least friction that the plan relies on (-)
SLIPPERY, ROUGH = 0.27, 0.6  # what there is (-)
PUSH = Push(force=np.array([0.0, 8.0, 0.0]), after=0.5, duration=0.3)  # eight times the weight
QUICK = ManipulationTimeline(
    approach=0.4, close=0.3, squeeze=0.3, verify=0.1, lift=0.4, height=0.03
)
SQUEEZES = (1.0, 2.0, 3.0, 4.0)  # least normal force of each finger, N

task = manipulation_task(HAND, parse_object(OBJECT, mass=MASS), mu=MU)
plan = plan_manipulation(task, angle=np.deg2rad(90.0), seed=0)
for title, mu, push in ((f"friction {SLIPPERY}", SLIPPERY, None), ("pushed", ROUGH, PUSH)):
    report = manipulate(plan, physics=PhysicsOptions(mu=mu), timeline=QUICK, push=push)
    print(f"{title}: {'complete' if report.complete else report.reason}")
    for kind in dict.fromkeys(event.kind for event in report.events):
        first = next(event for event in report.events if event.kind == kind)
        print(f"  {first.time:.2f} s {kind} {first.finger}: {first.detail}")

print("\nsqueeze (N)   possible at       in the way")
for squeeze in SQUEEZES:
    answers = []
    for knot in plan.knots:
        known = knot.forces.problem
        # velocity of each contact per joint velocity, from the plan's own programme, in its axes
        levers = known.joint_map.T.reshape(len(knot.contacts), 3, -1)
        answers.append(
            distribute_forces(
                knot.contacts,
                wrench=known.wrench,
                min_normal=squeeze,
                jacobians=knot.contacts.frames @ levers,
                actuation=task.hand.actuation,
                q=knot.q,
                gravity_torque=known.gravity_torque,
            )
        )
    limits = next((answer.limits[0] for answer in answers if not answer.found), "nothing")
    possible = f"{sum(answer.found for answer in answers)} of {len(answers)} poses"
    print(f"{squeeze:11.1f}   {possible:14}   {limits}")
