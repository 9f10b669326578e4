"""The lab's error "grasp analysis fails with few contacts", its three causes, and our diagnosis.

The lab says: check collision groups, adjust approach positions, verify friction. Each is broken
here on purpose, in the same planned grasp: a finger whose geometries do not collide with the
object, an object that stands beside its place, and contacts with less friction than the plan relies
on. Prints for each the verdict of the trial with its reason, and what the contacts before the lift
say: which fingers touch, force closure, and the largest share of a friction cone in use. A missing
finger is named. With too little friction all fingers are there, and contacts that are counted would
not tell: the friction cones are used up before the lift.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from planner import SE3, GraspTask, plan_grasp
from sim.scene.physics import PhysicsOptions
from sim.trial import Timeline, Trial

HAND = "allegro_hand"
OBJECT = "cylinder:0.03x0.10"
GHOST = "thumb"  # the finger that passes through the object
BESIDE = np.array([0.0, 0.035, 0.0])  # where the object really stands, m
SLIPPERY = 0.2  # friction (-); planning relies on 0.5
QUICK = Timeline.quick()

plan = plan_grasp(GraspTask.create(HAND, OBJECT), seed=0)
pose = plan.task.T_world_object
moved = replace(plan.task, T_world_object=SE3(pose.rotation, pose.translation + BESIDE))
trials = {
    "as planned": Trial(plan, timeline=QUICK),
    f"{GHOST} does not collide": Trial(plan, timeline=QUICK),
    "object beside its place": Trial(replace(plan, task=moved), timeline=QUICK),
    "too little friction": Trial(plan, timeline=QUICK, physics=PhysicsOptions(mu=SLIPPERY)),
}
ghost = trials[f"{GHOST} does not collide"].simulation.scene
for geom, finger in ghost.finger_of_geom.items():
    if finger == GHOST:
        ghost.model.geom_contype[geom] = ghost.model.geom_conaffinity[geom] = 0

for title, trial in trials.items():
    report = trial.run()
    samples = report.samples
    before = samples.during("squeeze", "settle")[-1]  # at the end of the grip, before the lift
    touching = [
        name
        for name, number in zip(report.fingers, samples.contacts[before], strict=True)
        if number > 0
    ]
    print(f"{title}: {'held' if report.success else report.reason}")
    print(f"  before the lift: {len(touching)} of {len(report.fingers)} fingers touch", end=" ")
    print(f"({', '.join(touching)}), closed: {samples.closed[before]}", end=", ")
    print(f"cone used {100 * np.nanmax(samples.friction_utilisation[before]):.0f} %")
    if not report.success:
        print(f"  {report.verdict.detail}")
