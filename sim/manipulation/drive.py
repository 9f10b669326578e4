"""What drives a manipulation: the fingers' controller over all phases, and the base's way.

Before the squeeze and up to the lowering it is ``ObjectImpedance``, led by a ``MotionReference``
during the turn; then the forces go down, and the fingers open to the planned posture.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner.errors import TaskError
from planner.motion.manipulation import ManipulationPlan
from planner.motion.path import tilts
from planner.spatial import SE3, FloatArray
from sim.controllers import Event, ObjectImpedance, Observation, Phase, Sensing
from sim.controllers.closed import MAX_NORMAL
from sim.controllers.follow import MotionReference
from sim.controllers.opening import PostureServo
from sim.gantry import Mount
from sim.manipulation.away import FingerAway
from sim.manipulation.idle import out_of_the_way
from sim.timeline import Timeline

__all__ = ["BaseMover", "MotionController"]

BEYOND, TILTED_BEYOND = np.deg2rad(0.5), np.deg2rad(1.0)
"""Turn (rad) beyond what is asked for, so that at least that is made whatever little comes back;
and about an axis that is not vertical, where the weight pulls some of it back."""


class MotionController:
    """Executes a ``ManipulationPlan``: closes, holds, turns, lets go.

    Attributes:
        holding: The closed loop that holds and turns.
        reference: What leads it during the turn, or during the stroke that it is in.
        away: What leads a finger that is off the object; None while there is none.
    """

    def __init__(
        self,
        plan: ManipulationPlan,
        *,
        rate: float,
        sensing: Sensing | None = None,
        mass: float | None = None,
        mu: float | None = None,
        max_normal: float = MAX_NORMAL,
    ) -> None:
        """Prepare.

        Args:
            plan: What to execute.
            rate: Largest rate of the turn, rad/s.
            sensing: How well the object is known.
            mass: Mass that the object is believed to have, kg; the task's if None.
            mu: Friction that is believed (-), a lower bound; the task's if None.
            max_normal: Largest normal force that a finger is asked for, N.
        """
        grasp = plan.motion.grasp
        self.holding = ObjectImpedance(
            grasp, sensing=sensing, mass=mass, mu=mu, max_normal=max_normal
        )
        self.away: FingerAway | None = None
        self._plan, self._rate = plan, rate
        self._motion = out_of_the_way(plan.motion)
        self.reference = self.begin_stroke(plan.angle)
        self._opening = PostureServo(grasp, plan.ending.release.q)

    @property
    def events(self) -> tuple[Event, ...]:
        """What was noticed, in order."""
        return self.holding.events

    def begin_stroke(self, left: float) -> MotionReference:
        """Lead the object along the planned motion again, from where it is.

        Args:
            left: Turn that is still to be made, rad, with its sign; as much of it is made as a
                stroke has.
        """
        motion = self._motion
        beyond = TILTED_BEYOND if tilts(motion.path.axis) else BEYOND
        most = min(abs(left) + beyond, abs(motion.path.angle))
        angle = math.copysign(most, self._plan.angle)
        self.reference = MotionReference(motion, angle=angle, rate=self._rate)
        self.holding.reference = self.reference
        return self.reference

    def begin_back(self) -> MotionReference:
        """Lead the object back to where the motion began, from where it is."""
        place = self.reference.place
        self.reference = MotionReference(self._motion, rate=self._rate, back_from=place)
        self.holding.reference = self.reference
        return self.reference

    @property
    def off(self) -> NDArray[np.bool_]:
        """Which fingers (n,) are to be off the object: told to leave, or on their way."""
        led = "" if self.away is None else self.away.finger
        names = np.array(self.holding.plan.task.finger_names)
        return np.asarray(~self.holding.schedule.wanted | (names == led))

    def step(self, observation: Observation) -> FloatArray:
        """Commands (nu,) for the hand's actuators."""
        if observation.phase in ("open", "retreat"):
            share = observation.progress if observation.phase == "open" else 1.0
            return self._opening.command(observation, share)
        ctrl = self.holding.step(observation)
        if self.away is None:
            return ctrl
        return np.where(self.away.actuators, self.away.command(observation), ctrl)

    def saturated_actuators(self) -> tuple[str, ...]:
        """Names of the actuators that could not give what the last step wanted."""
        return self.holding.saturated_actuators()


class BaseMover:
    """Moves the mount from pose to pose: a ``sim.carrier.Carrier``."""

    def __init__(self, mount: Mount | None, T_world_base: SE3) -> None:
        """Stay at a pose.

        Raises:
            TaskError: There is no mount: the hand is on an arm.
        """
        if mount is None:
            raise TaskError("the hand is on an arm; a manipulation needs a hand whose base is free")
        self._mount = mount
        self._from = self._to = mount.coordinates(T_world_base)
        self._duration = 1.0

    def stay(self) -> None:
        """Stay where it was sent last."""
        self._from = self._to

    def go(self, T_world_base: SE3, duration: float) -> None:
        """From where it was sent last to a pose, in a time (s) that is the phase's own."""
        self._from, self._to = self._to, self._mount.coordinates(T_world_base)
        self._duration = duration

    def drive(self, data: Any, phase: Phase, share: float) -> None:
        """Set the mount's commands for a share of the way."""
        del phase
        s, rate = Timeline.profile(share)
        way = self._to - self._from
        target, velocity = self._from + s * way, rate / self._duration * way
        data.ctrl[self._mount.ctrl] = self._mount.command(data, target, velocity)
