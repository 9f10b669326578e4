"""``Reclosing``: closes until felt; if the contacts contradict the joints, opens and closes anew.

Called by ``GraspController`` in the phase "close". The first closing finds out where the joints
are (``sim.controllers.calibration``), with light touches that move nothing. If they are off, the
fingers open again, at the joints that were found, and come down where the plan wants them. Exact
joints touch once.

The phase must not end while that goes on: ``closed`` tells a simulation when it may.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from planner.plan import GraspPlan
from planner.spatial import FloatArray, minimum_jerk
from sim.controllers.base import Observation, Recloses
from sim.controllers.calibration import Calibration
from sim.controllers.closing import GuardedClosing
from sim.controllers.readings import TOUCH_FORCE

OPEN_TIME, CLOSE_TIME = 0.3, 0.5
"""Time (s) to open after the first touch, and to close again: as a trial's own closing."""

LONGEST = 1.0
"""Longest time (s) for fingers that do not touch, once the way of a closing is over."""

RECLOSING_TIME = OPEN_TIME + CLOSE_TIME + LONGEST
"""Longest time (s) that a second closing takes."""

LEAST_LOOK = 2
"""Fewest fingers whose contacts are worth opening the hand for, if the others do not come."""


class Reclosing:
    """Reference posture while the fingers close, once or twice.

    Attributes:
        again: Whether it opened and closes a second time.
        busy: Whether the second closing goes on, though all fingers may touch.
    """

    def __init__(self, plan: GraspPlan, calibration: Calibration) -> None:
        """Prepare the first closing; the calibration is written."""
        self._plan, self._calibration = plan, calibration
        self._closing = self._first = GuardedClosing(plan)
        self._time, self._arrived = 0.0, 0.0
        self._from = plan.q
        self._looked = False
        self.again = self.busy = False

    @property
    def careful(self) -> bool:
        """Whether a touch came too early for exact joints."""
        return self._closing.careful

    def step(self, elapsed: float, observation: Observation) -> FloatArray:
        """Reference posture (nq,)."""
        if self.again:
            return self._second(elapsed, observation)
        arrived = observation.progress >= 1.0
        self._arrived += elapsed * arrived
        touching = int((observation.normal_forces >= TOUCH_FORCE).sum())
        late = self._arrived > LONGEST - OPEN_TIME and touching >= LEAST_LOOK
        if not self._looked and ((arrived and observation.all_touch) or late):
            self._looked = True
            if self._calibration.learn(observation):
                self.again = self.busy = True
                self._from = observation.q.copy()
        return self._closing.step(elapsed, observation)

    def _second(self, elapsed: float, observation: Observation) -> FloatArray:
        """Open, then close at the joints that were found."""
        self._time += elapsed
        since, offset = self._time - OPEN_TIME, self._calibration.offset
        if since < 0.0:
            share = float(minimum_jerk(np.asarray(self._time / OPEN_TIME)))
            return np.asarray(self._from + share * (self._plan.q_pregrasp + offset - self._from))
        if self._closing is self._first:
            self._closing = GuardedClosing(self._plan)
        seen = replace(observation, q=observation.q - offset, progress=min(1.0, since / CLOSE_TIME))
        if observation.all_touch or since > CLOSE_TIME + LONGEST:
            self.busy = False
        return np.asarray(self._closing.step(elapsed, seen) + offset)


def closed(controller: object, wait: float, timestep: float) -> Callable[[Observation], bool]:
    """Whether the phase "close" may end; asked after every step once its duration is over.

    Args:
        controller: Who closes; one that is no ``Recloses`` closes once.
        wait: Longest time (s) for fingers that do not touch; a second closing may take
            ``RECLOSING_TIME`` more.
        timestep: s.
    """
    most, asked = round(wait / timestep), 0

    def over(seen: Observation) -> bool:
        nonlocal asked
        asked += 1
        if isinstance(controller, Recloses) and controller.closing:
            return False
        return seen.all_touch or asked > most

    return over
