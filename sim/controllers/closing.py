"""``GuardedClosing``: moves every finger until it touches, wherever its encoders say that it is.

Called by ``GraspController`` in the phase "close". A finger goes from pre-grasp to grasp; where it
touches it stays, and one that arrives without touching goes on along its contact normal. One that
touches before it closes, as a link that comes down on the object's rim, opens further until it is
free, where the task says that joints may be off.

Joints that are off bring one finger to the object millimetres before the others. What cannot be the
object's place, a touch more than ``EARLY`` before the planned one, tells of that, and from then on
closing is careful: a finger that touched holds still where it is, a wall rather than a push, and
follows the object slowly along its normal if that moves off; the others come at
``CAREFUL_SPEED``, and search at it. So does a finger that is ``EARLY`` beyond its planned contact.
None searches on where that leads it into its neighbour: nothing was planned there.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner.plan import GraspPlan
from planner.search.beyond import Neighbours, search_directions
from planner.spatial import FloatArray, minimum_jerk
from sim.controllers.base import TOUCH_FORCE, Observation

CLOSE_RATE = 4.0
"""Fastest change (1/s) of a finger's share of the closing motion, for one that lost touch."""

SEARCH_SPEED = 0.01
"""Speed (m/s) along the normal of a finger that has arrived without touching."""

EARLY = 0.005
"""How far (m) from the planned contact a touch is no surprise: where an object stands is known to
some 3 mm and 5 degrees, and this is what a tip is off by if three joints are off by a degree and
more."""

CAREFUL_SPEED = 0.03
"""Speed (m/s) of a pad towards an object that may be elsewhere: a finger of 50 g gives an object of
100 g 1 cm/s at most."""

SEARCH_REACH = 0.02
"""How far (m) it searches beyond its planned contact: two standard deviations of a tip at the end
of 0.1 + 0.06 + 0.03 m of joints that are off by 3 degrees each are 12 mm, and the object is off as
well."""

WAY_SPEED, MOST_WAY = 0.1, 0.02
"""Speed (m/s) along the normal with which a finger opens that touches before it closes, about that
of the hand on its way in, and how far (m): as ``SEARCH_REACH``."""

LEAST_GAP = 0.002
"""Distance (m) from its neighbour, by the joints, within which a finger does not search towards it:
what plans leave between fingers."""

LOOK = 1e-4
"""Step of a joint (rad) of the differences that tell how it changes that distance."""


class GuardedClosing:
    """Reference posture while the fingers close.

    Attributes:
        careful: Whether a touch was too early for a calibrated hand.
    """

    def __init__(self, plan: GraspPlan) -> None:
        """Prepare search directions for a plan."""
        self._plan, self._fingers = plan, plan.task.fingers
        n = len(self._fingers)
        self._outermost_first = sorted(range(n), key=lambda i: -len(self._fingers[i].q_index))
        pressing = plan.task.outermost  # inner links that only touch do not look for the object
        self._searches = np.array(
            [not f.is_link or i in pressing for i, f in enumerate(self._fingers)]
        )
        self._directions = search_directions(plan)
        self._search, self._along = np.zeros((2, n, plan.task.hand.nq))
        for i, one in enumerate(self._directions):
            self._search[i, one.index], self._along[i, one.index] = one.straight, one.along
        self._share, self._reach, self._follows, self._way = np.zeros((4, n))
        self._moved = np.zeros_like(self._search)  # by searching, rad
        way = np.abs(self._along @ (plan.q - plan.q_pregrasp))
        self._careful_rate = CAREFUL_SPEED / np.maximum(way, CAREFUL_SPEED / CLOSE_RATE)
        self._touched: NDArray[np.bool_] = np.zeros(n, dtype=bool)
        self._held: dict[int, FloatArray] = {}
        self._neighbours = Neighbours(plan.task.hand, self._fingers)
        self.careful = plan.task.object.belief is not None  # its place is known to millimetres

    def make_way(self, elapsed: float, observation: Observation) -> FloatArray:
        """Pre-grasp posture (nq,), further open where fingers that have not closed touch."""
        early = self._early(observation)
        self._way[early] = np.minimum(MOST_WAY, self._way + WAY_SPEED * elapsed)[early]
        return np.asarray(self._plan.q_pregrasp - self._way @ self._search)

    def _early(self, observation: Observation) -> NDArray[np.bool_]:
        """Which fingers (n,) touch before they close, and can open further."""
        touching = observation.normal_forces >= TOUCH_FORCE
        if self._plan.task.joint_error == 0.0:  # a link is where it is planned: it met nothing
            return np.zeros(len(touching), dtype=bool)
        waits = self._searches & (self._share == 0.0) & (self._way < MOST_WAY)
        return np.asarray(touching & waits & ~self._touched)

    def step(self, elapsed: float, observation: Observation) -> FloatArray:
        """Reference posture (nq,); advances every finger that does not touch."""
        plan = self._plan
        goal = float(minimum_jerk(np.asarray(observation.progress)))
        free = observation.normal_forces < TOUCH_FORCE
        opened = self.make_way(elapsed, observation)
        self._notice(~free & ~self._touched & ~self._early(observation), observation.q)
        arrived = self._share >= 1.0
        rate = self._careful_rate if self.careful else CLOSE_RATE
        self._share[free] = np.minimum(goal, self._share + rate * elapsed)[free]
        off = self.careful | (self._reach >= EARLY)
        speed = np.where(off, CAREFUL_SPEED, SEARCH_SPEED)
        for i in np.flatnonzero(free & arrived & self._searches).tolist():
            self._go_on(i, speed[i] * elapsed, observation.q)
        q = plan.q_pregrasp + goal * (plan.q - plan.q_pregrasp)
        for i in self._outermost_first:  # links have the last word on their finger's inner joints
            share, k = self._share[i], self._fingers[i].q_index
            if i in self._held:
                if free[i]:
                    self._follows[i] = min(SEARCH_REACH, self._follows[i] + SEARCH_SPEED * elapsed)
                q[k] = self._held[i] + self._follows[i] * self._search[i, k]
                self._reach[i], self._moved[i] = 0.0, 0.0
            else:
                q[k] = opened[k] + share * (plan.q[k] - opened[k])
        return np.asarray(q + self._moved.sum(axis=0))

    def _go_on(self, i: int, step: float, q: FloatArray) -> None:
        """Search on with a finger, by a step (m) along its normal, at joints as read (nq,).

        Near a neighbour it goes past it, or stays where there is no way past.
        """
        step = min(step, SEARCH_REACH - self._reach[i])
        way: FloatArray | None = self._directions[i].straight
        gap, k = self._neighbours.gap(i, q), self._directions[i].index
        if gap < LEAST_GAP:
            slope = np.zeros(len(k))
            for at, joint in enumerate(k.tolist()):
                ahead = q.copy()
                ahead[joint] += LOOK
                slope[at] = (self._neighbours.gap(i, ahead) - gap) / LOOK
            way = self._directions[i].around(slope)
        if way is not None:
            self._reach[i] += step
            self._moved[i, k] += step * way

    def _notice(self, new: NDArray[np.bool_], q: FloatArray) -> None:
        """Judge the first touches of fingers (n,) at joints as read (nq,)."""
        self._touched |= new
        for i in np.flatnonzero(new).tolist():
            left = float(self._along[i] @ (self._plan.q - q))  # to the planned contact, m
            if left > EARLY:
                self.careful = True
        if self.careful:
            for i in set(np.flatnonzero(self._touched).tolist()) - set(self._held):
                self._held[i] = q[self._fingers[i].q_index].copy()
