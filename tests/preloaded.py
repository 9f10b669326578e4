"""What the fork server of ``forks`` imports: all that a user's program may, the command line apart.

``sim.cli`` reads the width of the terminal when it is imported. What pages and examples plan most
is planned once, so that its problems are built and its loops loaded already in every fork.
"""

from contextlib import suppress

import planner
import sim

for package in (planner, sim):
    for name in package.__all__:
        getattr(package, name)

for thing in ("sphere", "cylinder", "box"):
    planner.plan_grasp(planner.GraspTask.create("allegro_hand", thing))
with suppress(planner.PlannerError), planner.compiled_searches():  # where numba is
    planner.plan_grasp(planner.GraspTask.create("allegro_hand", "sphere"))
