"""Find contact forces that balance a weight, on bare arrays; and see it refuse what cannot be.

Two soft fingers hold a box from its sides. Prints the forces that carry its weight; the same with
a grip; then two cases without an answer: a twist that the fingers cannot hold, and a weight that
is too large for a limit on normal force. An infeasible case names the wrench that is left over, the
share that can be resisted, and the limits in the way, instead of returning some forces.
"""

from __future__ import annotations

import numpy as np

from planner import ContactSet, distribute_forces
from planner.forces import gravity_wrench

MASS = 0.5  # kg
GRAVITY = (0.0, 0.0, -9.81)  # m/s2
HALF_WIDTH = 0.03  # of the box, m
MU, MU_TORSION = 0.5, 0.005  # sliding (-) and torsional (m) friction
GRIP = 8.0  # least normal force per finger in the second case, N
TWIST = 0.3  # torque about the line between the fingers, N m
WEAK = 4.0  # greatest normal force per finger in the last case, N

box = ContactSet.from_arrays(
    positions=[[-HALF_WIDTH, 0.0, 0.0], [HALF_WIDTH, 0.0, 0.0]],
    normals=[[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]],
    mu=MU,
    mu_torsion=MU_TORSION,
    model="soft",
    fingers=["thumb", "index"],
)
weight = gravity_wrench(MASS, GRAVITY)
twisted = weight + np.array([0.0, 0.0, 0.0, TWIST, 0.0, 0.0])
cases = {
    f"carry {MASS} kg": distribute_forces(box, wrench=weight),
    f"carry it with a grip of {GRIP} N": distribute_forces(box, wrench=weight, min_normal=GRIP),
    f"and a twist of {TWIST} N m, pressing with 20 N at most": distribute_forces(
        box, wrench=twisted, max_normal=20.0
    ),
    f"carry it with {WEAK} N at most": distribute_forces(box, wrench=weight, max_normal=WEAK),
}
for title, solution in cases.items():
    print(f"{title}: {'found' if solution.found else 'INFEASIBLE'}")
    if solution.found:
        used = solution.contacts.friction_utilisation()
        for name, force, share in zip(box.fingers, solution.forces, used, strict=True):
            normal, tangential = force[0], np.hypot(force[1], force[2])
            print(
                f"  {name}: presses {normal:.2f} N, carries {tangential:.2f} N by friction, ",
                end="",
            )
            print(f"{100 * share:.0f} % of the cone")
        # Recomputed from the forces: the solver's word is not the evidence.
        print(f"  balance is missed by {np.abs(solution.residuals.wrench).max():.1e} N or N m")
    else:
        print(f"  {solution.reason}")
        print(f"  left over: {np.round(solution.unresisted_wrench, 3) + 0.0} N, N m")
        print(f"  can be resisted: {100 * solution.fraction:.0f} % of it")
    print()
