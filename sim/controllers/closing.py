"""``GuardedClosing``: moves every finger until it touches, wherever its encoders say that it is.

Called by ``GraspController`` in the phase "close". A finger goes from pre-grasp to grasp; where it
touches it stays, and one that arrives without touching goes on along its contact normal.

Joints that are off bring one finger to the object millimetres before the others. What cannot be the
object's place, a touch more than ``EARLY`` before the planned one, tells of that, and from then on
closing is careful: a finger that touched holds still where it is, a wall rather than a push, and
follows the object slowly along its normal if that moves off; the others come at
``CAREFUL_SPEED``, and search at it. So does a finger that is ``EARLY`` beyond its planned contact.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner.kinematics.state import HandState
from planner.plan import GraspPlan
from planner.spatial import FloatArray, minimum_jerk
from sim.controllers.base import Observation
from sim.controllers.schedule import TOUCH_FORCE

__all__ = ["SEARCH_DAMPING", "GuardedClosing"]

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

SEARCH_DAMPING = 0.01
"""Damping (m/rad) of the inverse that turns the search into joint motion; keeps a straight finger
from swinging."""


class GuardedClosing:
    """Reference posture while the fingers close.

    Attributes:
        careful: Whether a touch was too early for a calibrated hand.
    """

    def __init__(self, plan: GraspPlan) -> None:
        """Prepare search directions for a plan."""
        self._plan, self._fingers = plan, plan.task.fingers
        n = len(self._fingers)
        self._search, self._along = _search_directions(plan)
        self._share, self._reach, self._follows = np.zeros((3, n))
        way = np.abs(self._along @ (plan.q - plan.q_pregrasp))
        self._careful_rate = CAREFUL_SPEED / np.maximum(way, CAREFUL_SPEED / CLOSE_RATE)
        self._touched: NDArray[np.bool_] = np.zeros(n, dtype=bool)
        self._held: dict[int, FloatArray] = {}
        self.careful = False

    def step(self, elapsed: float, observation: Observation) -> FloatArray:
        """Reference posture (nq,); advances every finger that does not touch."""
        plan = self._plan
        goal = float(minimum_jerk(np.asarray(observation.progress)))
        free = observation.normal_forces < TOUCH_FORCE
        self._notice(~free & ~self._touched, observation.q)
        arrived = self._share >= 1.0
        rate = self._careful_rate if self.careful else CLOSE_RATE
        self._share[free] = np.minimum(goal, self._share + rate * elapsed)[free]
        off = self.careful | (self._reach >= EARLY)
        speed = np.where(off, CAREFUL_SPEED, SEARCH_SPEED)
        self._reach[free & arrived] += speed[free & arrived] * elapsed
        self._reach = np.minimum(self._reach, SEARCH_REACH)
        q = plan.q_pregrasp + goal * (plan.q - plan.q_pregrasp)
        for i, (finger, share) in enumerate(zip(self._fingers, self._share, strict=True)):
            k = finger.q_index
            if i in self._held:
                if free[i]:
                    self._follows[i] = min(SEARCH_REACH, self._follows[i] + SEARCH_SPEED * elapsed)
                q[k] = self._held[i] + self._follows[i] * self._search[i, k]
                self._reach[i] = 0.0
            else:
                q[k] = plan.q_pregrasp[k] + share * (plan.q[k] - plan.q_pregrasp[k])
        return np.asarray(q + self._reach @ self._search)

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


def _search_directions(plan: GraspPlan) -> tuple[FloatArray, FloatArray]:
    """Joint motion (n, nq), rad/m, that moves each pad along its normal; and motion along it.

    The second (n, nq), m/rad, is the pad's motion along the normal per joint.
    """
    state = HandState(plan.task.hand, plan.q)
    inverse = plan.T_world_base.inverse()
    fingers = plan.task.fingers
    search, along = np.zeros((2, len(fingers), plan.task.hand.nq))
    for i, (finger, point, normal) in enumerate(
        zip(fingers, plan.contacts.positions, plan.contacts.normals, strict=True)
    ):
        k = finger.q_index
        jacobian = state.point_jacobian(finger.pad.joint_id, inverse.act(point))[:3]
        jacobian = jacobian[:, k]
        gram = jacobian @ jacobian.T + SEARCH_DAMPING**2 * np.eye(3)
        inwards = inverse.rotation @ normal
        search[i, k] = jacobian.T @ np.linalg.solve(gram, inwards)
        along[i, k] = jacobian.T @ inwards
    return search, along
