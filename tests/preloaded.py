"""What the fork server of ``forks`` imports: all that a user's program may, the command line apart.

``sim.cli`` reads the width of the terminal when it is imported. What pages and examples plan most
is planned once, so that its problems are built already in every fork.
"""

import planner
import sim

for package in (planner, sim):
    for name in package.__all__:
        getattr(package, name)

for thing in ("sphere", "cylinder", "box"):
    planner.plan_grasp(planner.GraspTask.create("allegro_hand", thing))
