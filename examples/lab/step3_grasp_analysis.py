"""The lab's step 3: contacts of a real grasp, the grasp matrix, force closure and epsilon.

A held object in MuJoCo is the witness of a contact analysis: what the contacts do to it must carry
its weight. The lab adds up forces that are in the contacts' own frames, with signs that depend on
the order of geometries, and gets anything at all. Prints contacts, both sums, closure and epsilon,
and closure of all pairs and triples of these contacts: the lab asks for three at least, but
friction and place decide. Two points never close a grasp, for nothing resists a turn about the line
between them (rank 5); two soft fingers that face each other do, and three on one side do not.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import mujoco
import numpy as np

from planner import ContactSet, GraspTask, analyse, force_closure, plan_grasp
from planner.contacts import ContactModel
from planner.forces import gravity_wrench
from sim.contacts import hand_contacts, merge_per_finger, object_contacts
from sim.trial import Timeline, Trial

HAND = "allegro_hand"
OBJECT = "cylinder:0.03x0.10"

plan = plan_grasp(GraspTask.create(HAND, OBJECT), seed=0)
task = plan.task
trial = Trial(plan, timeline=Timeline(lift=0.5, hold=1.0))
report = trial.run()
contacts = merge_per_finger(hand_contacts(trial.simulation.scene, trial.simulation.data))
print(f"{HAND} holds {OBJECT}: {report.success}")
for i in range(len(contacts)):
    contact = contacts[i]
    print(f"  {contact.finger:7} presses {contact.force[0]:.2f} N along", end=" ")
    print(np.round(contact.frame[:, 0], 2), f"({contact.model}, mu {contact.mu:.2f})")

print(f"grasp matrix {contacts.grasp_map().shape}", end=", ")
print(f"rank {np.linalg.matrix_rank(contacts.grasp_map())}")
as_in_the_lab, force = np.zeros(3), np.zeros(6)
for i, _geom, _sign in object_contacts(trial.simulation.scene, trial.simulation.data):
    mujoco.mj_contactForce(trial.simulation.scene.model, trial.simulation.data, i, force)
    as_in_the_lab += force[:3]
weight = gravity_wrench(task.object.mass, task.gravity)
print(f"the weight is       {np.round(weight[:3], 3) + 0.0} N")
print(f"the hand's force is {np.round(contacts.wrench()[:3], 3) + 0.0} N", end=", ")
print(f"added up as the lab does {np.round(as_in_the_lab, 3)} N")
print(analyse(contacts, length=task.object.shape.bounding_radius), "\n")


def told(fingers: tuple[str, ...], model: ContactModel) -> str:
    """Whether the contacts of some fingers close a grasp under a friction law."""
    kept = [replace(c, model=model) for c in map(contacts.__getitem__, range(len(contacts)))]
    subset = [contact for contact in kept if contact.finger in fingers]
    answer = force_closure(ContactSet.from_contacts(subset, center=contacts.center))
    return "closed" if answer.closed else f"open, rank {answer.rank}"


print(f"{'fingers':24} {'as points':14} as soft fingers")
for size in (2, 3):
    for fingers in combinations(contacts.fingers, size):
        print(f"{' + '.join(fingers):24} {told(fingers, 'point'):14} {told(fingers, 'soft')}")
