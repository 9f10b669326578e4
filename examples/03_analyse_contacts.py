"""Type contacts in as bare arrays and ask whether they close a grasp; no hand, no simulator.

Two opposed point contacts do not close a grasp: nothing resists a turn about the line between
them. The same two as soft fingers do, and so do three point contacts around a sphere. For each
prints the decision with its reason, and epsilon as an interval that is certain to hold the value
for true, round friction cones.
"""

from __future__ import annotations

import numpy as np

from planner import ContactSet, analyse

RADIUS = 0.035  # of the sphere, m; also what torques are divided by
MU = 0.5  # sliding friction (-)
MU_TORSION = 0.01  # torsional friction of a soft finger, m
EDGES = 8  # sides of each friction pyramid

# Points on the unit sphere; the normal into the object is minus the point.
opposed = np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]])
angles = np.deg2rad([90.0, 210.0, 330.0])
around = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(3)])

cases = {
    "two opposed point contacts": ContactSet.from_arrays(RADIUS * opposed, -opposed, mu=MU),
    "two opposed soft fingers": ContactSet.from_arrays(
        RADIUS * opposed, -opposed, mu=MU, mu_torsion=MU_TORSION, model="soft"
    ),
    "three point contacts around a sphere": ContactSet.from_arrays(RADIUS * around, -around, mu=MU),
    "the same three without friction": ContactSet.from_arrays(
        RADIUS * around, -around, model="frictionless"
    ),
}
for title, contacts in cases.items():
    report = analyse(contacts, length=RADIUS, edges=EDGES)
    closure = report.closure
    print(title)
    print(f"  decision         {closure.reason}")
    print(f"  min-weight       {closure.normalised_min_weight:.3f} (normalised, 1 is best)")
    print(f"  epsilon          {report.epsilon:.4f} with {EDGES} edges, true cones in ", end="")
    print(f"[{report.epsilon_round.lower:.4f}, {report.epsilon_round.upper:.4f}]")
    if closure.unresisted_wrench is not None:
        # Adding 0 turns -0 into 0.
        force, torque = np.split(np.round(closure.unresisted_wrench, 4) + 0.0, 2)
        print(f"  cannot resist    force {force} N with torque {torque} N m")
    print()

print("Everything that the analysis knows of the three contacts:")
print(analyse(cases["three point contacts around a sphere"], length=RADIUS, edges=EDGES))
