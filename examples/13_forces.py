"""Contact forces for controllers: the loop, the solvers, the pyramid against the cone, priorities.

Five fingers hold a ball of 3 cm. Prints what a step of the kept programme costs and how the answer
follows a finger that leaves; the solvers that are installed, side by side on one sequence; how the
answer of a friction pyramid nears the round cone's with its sides (where Clarabel is installed);
and what is done for a wrench that cannot be met.
"""

from __future__ import annotations

from importlib.util import find_spec

import numpy as np

from planner import ContactSet
from planner.forces import (
    ForceLoop,
    build_force_problem,
    compare_solvers,
    cone_gaps,
    gravity_wrench,
    least_violation,
    turning_wrenches,
)

RADIUS, MASS = 0.03, 0.1  # m, kg
MU = 0.6  # sliding friction (-)
GRIP = 0.3  # least normal force per finger, N
STEPS = 200  # of the sequence that solvers are compared on
WEAK = 0.2  # greatest normal force where the weight cannot be held, N

angle = 2 * np.pi / 4 * np.arange(4)
around = np.stack([np.cos(angle), np.sin(angle), np.full(4, 0.3)], axis=1)
outward = np.vstack([around, [0.1, 0.0, -1.0]])
outward /= np.linalg.norm(outward, axis=1, keepdims=True)
names = ["thumb", "index", "middle", "ring", "little"]
ball = ContactSet.from_arrays(RADIUS * outward, -outward, mu=MU, fingers=names)
weight = gravity_wrench(MASS, (0.0, 0.0, -9.81))
wrenches = turning_wrenches(MASS * 9.81, RADIUS, STEPS)

loop = ForceLoop(ball, min_normal=GRIP, change_cost=0.1)
print("normal forces as the little finger leaves and comes back:")
for reach in (np.inf, 0.5, 0.0, np.inf):
    most = np.array([np.inf, np.inf, np.inf, np.inf, reach])
    step = loop.step(weight, max_normal=most)
    forces = ", ".join(f"{f:.2f}" for f in np.abs(step.forces[:, 0]))
    print(f"  little at most {reach} N: {forces} N, balanced: {step.balanced}")
times = np.array([(s.total_s, s.solver_s) for s in map(loop.step, wrenches)]) * 1e6
print(f"a step takes {np.median(times[:, 0]):.0f} us, {np.median(times[:, 1]):.0f} in the solver")

print()
print(compare_solvers(ball, wrenches, min_normal=GRIP))

print()
if find_spec("clarabel") is None:
    print("pyramids against the cone: pip install 'opposable[solvers]'")
else:
    for gap in cone_gaps(ball, wrenches[::20], wrench=weight, min_normal=GRIP, sides=(4, 8, 16)):
        print(
            f"{gap.cone:<13} {gap.edges:>2} sides: {gap.median_cost:+.1%} of the cone's cost, "
            f"forces {gap.median_N:.3f} N away"
        )

print()
nearest = least_violation(build_force_problem(ball, wrench=weight, max_normal=WEAK))
print(f"at most {WEAK} N per finger: {nearest.size:.2f} N of {MASS * 9.81:.2f} N are left over")
