"""Certify a plan: how hard must you push to break it, and how wrong may its contacts be?

Every line has two ends. The lower end is proven: no push below it breaks the grasp, no error below
it loses closure. The upper end is a push that is proven to break it, or an error that was found to.
Prints the certificate with every promise tried on random errors; then the same push by hand, first
a little below and then a little above what the certificate says.
"""

from __future__ import annotations

from planner import GraspTask, distribute_forces, plan_grasp
from planner.certify import breaking_along, certify

SAMPLES = 200  # random errors of every kind, each within its promise
OBJECT = "ellipsoid:0.09x0.07x0.06"  # full lengths, m

plan = plan_grasp(GraspTask.create("allegro_hand", OBJECT), seed=0)
certificate = certify(plan, samples=SAMPLES)
print(certificate)
print()

# The smallest force that breaks the grasp, and the force problem of the plan, to ask it again.
force = certificate.breaking[0]
problem = plan.forces.problem
print(f"pushing along it, {force.unit}:")
bounds = breaking_along(problem, force.wrench)
print(f"  the grasp bears {bounds.lower:.4f} to {bounds.upper:.4f} of it")

# Without a hand there are no torque limits: then friction alone decides, and presses ever harder.
for share in (0.5, 2.0):
    found = distribute_forces(plan.contacts, wrench=problem.wrench + share * force.wrench).found
    print(f"  {share} of it, fingers of unlimited strength: {'held' if found else 'not held'}")

# The same numbers for a program.
data = certificate.as_dict()
for tolerance in data["tolerances"]:
    print(f"{tolerance['kind']:>11}: {tolerance['promised']:.2f} {tolerance['unit']} promised")
