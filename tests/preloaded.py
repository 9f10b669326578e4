"""What the fork server of ``forks`` imports: all that a user's program may, the command line apart.

``sim.cli`` reads the width of the terminal when it is imported.
"""

import planner
import sim

for package in (planner, sim):
    for name in package.__all__:
        getattr(package, name)
