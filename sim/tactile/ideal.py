"""The sense ``exact``: what the simulator knows, as it is."""

from __future__ import annotations

from sim.controllers import Observation
from sim.controllers.touch import EXACT
from sim.tactile.senses import TouchContext, register_touch


class ExactSense:
    """Leaves an observation as it is."""

    def __init__(self, context: TouchContext) -> None:
        """Nothing to prepare."""
        del context

    def read(self, truth: Observation) -> Observation:
        """The truth."""
        return truth


register_touch(EXACT, ExactSense)
