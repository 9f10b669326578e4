"""The lab's step 6: the full demonstration, pick, turn by 90 degrees, place.

The lab's demonstration lifts nothing and places nothing. Here an object stands on a table and ends
elsewhere on it, and every phase ends in a check: numbers, and a reason if it failed. The true mass,
friction and place are not those that were planned for, since a plan that works for exact figures
only is none. Prints the check of every phase, contact modes over the turn, and the lab's own
questions with our answers: contacts, closure and epsilon before the lift and after the turn, the
turn that was asked for and the one that was made. On the command line: opposable manipulate --demo.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from planner import SE3, manipulation_task, parse_object, plan_manipulation
from sim.manipulation import ManipulationTimeline, manipulate
from sim.scene.physics import PhysicsOptions

HAND = "allegro_hand"
OBJECT = "cylinder:0.03x0.08"
TURN = 90.0  # degrees about the vertical
PLACE = (0.10, 0.05)  # where the object is to stand, m; it is picked from (0, 0)
MU, MAX_MASS = 0.45, 0.2  # least friction (-) and largest mass (kg) that are planned for
TRUE_MU, TRUE_MASS = 0.6, 0.1  # what there is
BESIDE = np.array([0.002, -0.001, 0.0])  # how far it stands from where it should, m
QUICK = ManipulationTimeline(  # s; height in m
    approach=0.4, close=0.3, squeeze=0.3, lift=0.4, carry=0.4, lower=0.4, retreat=0.4, height=0.03
)

task = manipulation_task(HAND, parse_object(OBJECT, mass=MAX_MASS), mu=MU)
plan = plan_manipulation(task, angle=np.deg2rad(TURN), place=PLACE, seed=0)
print(f"planned in {plan.attempts} attempts: {plan.path}")

pose = plan.task.T_world_object
truth = replace(
    plan.task,
    object=parse_object(OBJECT, mass=TRUE_MASS),
    T_world_object=SE3(pose.rotation, pose.translation + BESIDE),
)
report = manipulate(plan, true_task=truth, physics=PhysicsOptions(mu=TRUE_MU), timeline=QUICK)
print(report)

for title, quality in (("grasped", report.before), ("turned", report.after)):
    if quality is not None:
        closed, contacts = quality.closure.closed, quality.n_contacts
        print(f"{title}: {contacts} contacts, closed: {closed}, epsilon {quality.epsilon:.3f}")
print(f"asked for {TURN:.1f} degrees, turned by {np.rad2deg(report.turned):.1f}")
print("demonstration:", "complete" if report.complete else f"failed, {report.reason}")
