"""The sense ``binary``: which pads touch, and nothing else; the cheapest there is.

A pad touches from ``ON`` on and until its force falls below ``OFF``. Force, place and normal are
those of the plan: the planned grip along the planned normal, turned as the fingertips have turned
about each other (``PlannedPads``).
"""

from __future__ import annotations

import numpy as np

from sim.controllers import Observation
from sim.sensing.touch.senses import PlannedPads, TouchContext, register_touch

ON, OFF = 0.08, 0.04
"""Normal force (N) from which on a pad says that it touches, and below which it stops."""


class BinarySense:
    """Contact, yes or no."""

    def __init__(self, context: TouchContext) -> None:
        """Nothing touches yet."""
        task = context.plan.task
        self._pads = PlannedPads(context)
        self._grip = task.grip_force
        self._touching = np.zeros(len(task.fingers), dtype=bool)

    def read(self, truth: Observation) -> Observation:
        """The observation with contact, yes or no."""
        felt = truth.normal_forces
        self._touching = np.where(self._touching, felt >= OFF, felt >= ON)
        normal, position = self._pads.expected(truth.T_world_base)
        force = self._grip * normal
        return self._pads.observation(truth, self._touching, force, normal, position)


register_touch("binary", BinarySense)
