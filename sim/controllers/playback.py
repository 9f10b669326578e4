"""``Playback``: the open loop of a motion: planned joints and forces at planned times.

It closes and presses like ``GraspController``. From the beginning of the turn on it does not look
at the object: joints and contact forces are those of the plan, interpolated between its knots, at
the rate at which the closed loop turns an object that follows at once. ``sim.bench.reality``
compares it with loops: it is what a plan is worth without feedback.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline

from planner.motion import MotionPlan
from planner.spatial import SE3, FloatArray
from sim.controllers.base import Observation, Phase
from sim.controllers.follow import RATE, MotionReference
from sim.controllers.grasp import GraspController
from sim.controllers.loads import crossed
from sim.controllers.reference import Target

__all__ = ["Playback"]

PLAYED: frozenset[Phase] = frozenset({"turn", "hold"})
"""Phases in which the motion goes on, until it is over."""


class Playback(GraspController):
    """Plays a motion back.

    Attributes:
        place: Where on the planned path it is, 0 to 1.
    """

    def __init__(
        self, motion: MotionPlan, *, angle: float | None = None, rate: float = RATE
    ) -> None:
        """Prepare for a motion on one grasp.

        Args:
            motion: What is played back.
            angle: Turn at which it ends, rad; the planned one if None.
            rate: Largest rate of the turn, rad/s.

        Raises:
            TaskError: A rate that is not positive, or an angle that was not planned for.
        """
        super().__init__(motion.grasp)
        self._reference = MotionReference(motion, angle=angle, rate=rate)
        knots = [knot.contacts_in_object for knot in motion.knots]
        rows = [[one.positions, one.forces_in_axes()] for one in knots]
        self._contacts = CubicSpline([k.path_parameter for k in motion.knots], rows)
        T_palm_world = motion.grasp.T_world_palm.inverse()
        self._in_palm: SE3 = T_palm_world * motion.knots[0].T_world_object
        self._target: Target | None = None
        self._played = 0.0
        self._released = 1.0

    @property
    def place(self) -> float:
        """Where on the planned path it is, 0 to 1."""
        return 0.0 if self._target is None else self._reference.place

    def step(self, observation: Observation) -> FloatArray:
        """Commands (nu,) for the hand's actuators."""
        elapsed, self._played = observation.time - self._played, observation.time
        if observation.phase in PLAYED and (self._target or observation.phase == "turn"):
            self._play(elapsed)
        released = observation.progress if observation.phase == "release" else 0.0
        self._released = 1.0 - released
        return super().step(observation)

    def _play(self, elapsed: float) -> None:
        """Go on; the reference is told that the object is where it was wanted."""
        known = self._in_palm if self._target is None else self._target.T_palm_object
        tips = np.zeros((len(self._fingers), 3))
        target = self._reference.advance(elapsed, known, tips, self.q_ref, missed=0.0)
        self._target = target
        self.q_ref, self._still = target.q, target.v
        self._points, self._forces = self._contacts(self._reference.place)

    def _pressing_torque(self, observation: Observation) -> FloatArray:
        """Joint torques (nq,) of the planned forces where the plan has the object."""
        if self._target is None:
            return self._released * super()._pressing_torque(observation)
        T_base_object = self._loads.T_base_palm * self._target.T_palm_object
        turn = T_base_object.rotation.T
        points = self._points @ turn + T_base_object.translation
        forces = self._forces @ turn
        return self._released * self._loads.torque(forces, crossed(points, forces))
