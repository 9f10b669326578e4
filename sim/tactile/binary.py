"""The sense ``binary``: which pads touch, and nothing else; the cheapest there is.

A pad touches from ``ON`` on and until its force falls below ``OFF``. Force, place and normal are
those of the plan: the planned grip along the planned normal, turned as the fingertips have turned
about each other (``PlannedNormals``).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sim.controllers import Observation, TouchReading
from sim.tactile.bodies import PadBodies, PlannedNormals, pad_reading
from sim.tactile.exact import layouts_of
from sim.tactile.senses import TouchContext, register_touch

ON, OFF = 0.08, 0.04
"""Normal force (N) from which on a pad says that it touches, and below which it stops."""


class BinarySense:
    """Contact, yes or no."""

    def __init__(self, context: TouchContext) -> None:
        """Nothing touches yet."""
        plan = context.plan
        layouts = layouts_of(context.scene, plan.task.finger_names)
        self._bodies = PadBodies.of(context.scene, context.data, layouts)
        self._planned = PlannedNormals(plan)
        self._centers = np.array([one.center for one in layouts])
        self._radii = np.array([[one.radius] for one in layouts])
        self._grip = plan.task.grip_force
        self._touching = np.zeros(len(layouts), dtype=bool)

    def read(self, truth: Observation) -> Observation:
        """The observation with contact, yes or no."""
        felt = truth.normal_forces
        self._touching = np.where(self._touching, felt >= OFF, felt >= ON)
        touching, turns = self._touching, self._bodies.turns()
        middle = (turns @ self._centers[:, :, None])[:, :, 0] + self._bodies.places()
        normal = self._planned.at(middle, truth.T_world_base)
        position = middle + self._radii * normal

        reading = pad_reading(
            touching=touching,
            force=self._grip * normal,
            normal=normal,
            position=position,
            sliding=self._bodies.sliding(position, normal, touching, np.ones(len(touching))),
        )
        return replace(
            truth,
            normal_forces=reading.normal_force,
            read_pads=lambda: reading,
            read_touch=TouchReading.nothing,
        )


register_touch("binary", BinarySense)
