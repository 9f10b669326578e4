"""``Stage``: the trial of a manipulation, without its script: it runs phases and takes samples."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from planner.motion.manipulation import ManipulationPlan
from planner.spatial import SE3, FloatArray
from planner.task import GraspTask
from sim.contacts import hand_contacts
from sim.controllers import Observation, Phase, Sensing
from sim.manipulation.drive import BaseMover, MotionController
from sim.manipulation.pace import IN_THE_AIR, Pace, Step
from sim.manipulation.samples import Watch
from sim.physics import PhysicsOptions
from sim.simulation import Simulation

__all__ = ["PHASE_OF", "Push", "Stage"]

SAMPLE_EVERY = 0.02
"""Time between samples, s: that at which strict verdicts look."""

PHASE_OF: dict[Step, Phase] = {
    "stand": "approach",
    "approach": "approach",
    "close": "close",
    "squeeze": "squeeze",
    "verify": "settle",
    "lift": "lift",
    "turn": "turn",
    "hold": "hold",
    "verify again": "hold",
    "carry": "carry",
    "lower": "lower",
    "release": "release",
    "open": "open",
    "retreat": "retreat",
    "regrasp": "hold",
    "back": "turn",
}
"""What each phase is to a controller."""


@dataclass(frozen=True, kw_only=True)
class Push:
    """A force on the object's centre of mass while it is turned, once.

    Attributes:
        force: (3,), N, world.
        after: When, since the beginning of the turn, s.
        duration: How long, s.
    """

    force: FloatArray
    after: float
    duration: float


class Stage(Simulation):
    """Scene, controller, base and samples of one manipulation.

    Attributes:
        driver: What drives the fingers.
        mover: What moves the base.
        watch: What takes samples.
    """

    def __init__(
        self,
        plan: ManipulationPlan,
        *,
        really: GraspTask | None,
        physics: PhysicsOptions | None,
        sensing: Sensing | None,
        pace: Pace,
        push: Push | None,
        max_normal: float,
    ) -> None:
        """Build the scene and put hand and object at their start; see ``manipulate``.

        ``max_normal`` is the largest normal force (N) that a finger is asked for.
        """
        grasp = plan.motion.grasp
        self.driver = MotionController(
            plan, rate=pace.turn_rate, sensing=sensing, max_normal=max_normal
        )
        there = really or grasp.task
        there = replace(there, obstacles=(*there.obstacles, *plan.under_target))
        super().__init__(replace(grasp, task=there), physics=physics, controller=self.driver)
        self._push = push
        self._turn_began: float | None = None
        self.mover = BaseMover(self.scene.mount, grasp.T_world_base_start)
        self.carrier = self.mover
        self.watch = Watch(self.scene, self.driver.reference.axis)
        self._sample_steps = max(1, round(SAMPLE_EVERY / self.scene.physics.timestep))

    def advance(
        self,
        step: Step,
        duration: float,
        *,
        wait: float = 0.0,
        until: Callable[[bool], bool] | None = None,
    ) -> str:
        """Run a phase for its duration, and longer where something is waited for.

        Args:
            step: Which phase.
            duration: s.
            wait: Longest further time, s.
            until: Whether the phase may end after ``duration``, asked after every step with
                whether all fingers touched; at once if None.

        Returns:
            Why it ended early, "" if it did not: the simulation diverged, or the object fell.
        """
        dt = self.scene.physics.timestep
        steps, longest = max(1, round(duration / dt)), round((duration + wait) / dt)
        if step == "turn" and self._turn_began is None:
            self._turn_began = float(self.data.time)
        fault = ""
        for k in range(max(steps, longest)):
            if self._push is not None and step in ("turn", "regrasp"):
                self._push_object(self._push)
            touching = self.step(PHASE_OF[step], min(1.0, k / steps)).all_touch
            due = self.steps % self._sample_steps == 0
            fault = self.diverged or (self._dropped(step) if due else "")
            if fault or due:
                driver = self.driver
                self.watch.take(
                    self.data,
                    step,
                    driver.reference.place,
                    driver.holding.T_palm_wanted,
                    driver.off,
                )
            if fault or (k + 1 >= steps and (until is None or until(touching))):
                break
        self.data.xfrc_applied[self.scene.object_body] = 0.0
        self.mover.stay()
        return fault

    def observe(self, phase: Phase, share: float) -> Observation:
        """As every trial does; the forces are noted for the next sample."""
        observation = super().observe(phase, share)
        self.watch.feel(observation.normal_forces)
        return observation

    @property
    def touched(self) -> bool:
        """Whether anything of the hand presses on the object."""
        return len(hand_contacts(self.scene, self.data)) > 0

    def base_for(self, T_world_object: SE3) -> SE3:
        """Where the base must be for the object, as it lies in the hand now, to be at a pose."""
        return T_world_object * self.T_world_object.inverse() * self.T_world_base

    def _push_object(self, push: Push) -> None:
        """Push while it is time to."""
        since = float(self.data.time) - (self._turn_began or 0.0)
        pushed = 0.0 <= since - push.after < push.duration
        force = push.force if pushed else np.zeros(3)
        self.data.xfrc_applied[self.scene.object_body, :3] = force

    def _dropped(self, step: Step) -> str:
        """Why the object counts as dropped, "" if it does not."""
        if step not in IN_THE_AIR or self.touched:
            return ""
        gave_up = self.driver.holding.gave_up
        return "the object was dropped" + (f": {gave_up}" if gave_up else "")
