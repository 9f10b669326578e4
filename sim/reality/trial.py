"""``RealityOfTrial``: the reality of one trial, between a simulation and its controller.

truth -> read -> controller -> drive -> ctrl
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import mujoco

from planner.plan import GraspPlan
from planner.spatial import FloatArray
from planner.task import GraspTask
from sim.controllers import Observation
from sim.reality.drawn import Drawn
from sim.reality.drive import RealDrive
from sim.reality.errors import Reality
from sim.reality.senses import RealSenses
from sim.reality.words import drawn_numbers, draws_in_words
from sim.reality.world import change_world, lifted_by
from sim.scene import Scene
from sim.tactile import TaxelSense, TouchContext, TouchSense, make_sense


class RealityOfTrial:
    """Errors as drawn, with what applies them.

    Attributes:
        reality: How large errors are.
        drawn: What was drawn of them.
        task: What there is without errors.
    """

    def __init__(self, reality: Reality, task: GraspTask, drawn: Drawn | None = None) -> None:
        """Draw the errors of a trial.

        Args:
            reality: How large they are.
            task: What there is without them.
            drawn: What stays the same, if it is not to be drawn: that of a report, say.
        """
        self.reality, self.task = reality, task
        self.drawn = drawn or Drawn.of(reality, task.hand)
        self._senses = RealSenses(reality, self.drawn, task)
        self._drive = RealDrive(reality, self.drawn, task.hand.actuation)
        self._touch: TouchSense | None = None
        self._last: Observation | None = None

    @property
    def change(self) -> Callable[[Any], None]:
        """Changes a scene's specification to what there really is; for ``build_scene``."""
        return change_world(self.reality, self.drawn, self.task)

    def feel(self, scene: Scene, data: Any, plan: GraspPlan) -> None:
        """Feel touch in a scene from now on.

        Args:
            scene: The scene.
            data: ``mujoco.MjData``, as it is at every step.
            plan: What is executed.
        """
        context = TouchContext(
            scene=scene,
            data=data,
            plan=plan,
            seed=self.reality.seed,
            dry_friction=self.reality.dry_friction,
        )
        self._touch = make_sense(self.reality.touch, context)

    def place(self, scene: Scene, data: Any) -> None:
        """Let the object, larger or smaller than believed, stand on what carries it."""
        up = lifted_by(self.drawn, self.task)
        if up:
            data.qpos[scene.object_qpos[2]] += up
            mujoco.mj_forward(scene.model, data)

    def read(self, truth: Observation) -> Observation:
        """What sensors say of the truth; asked again at the same time they say the same."""
        last = self._last
        if last is None or last.time != truth.time:
            felt = truth if self._touch is None else self._touch.read(truth)
            self._last = last = self._senses.read(felt, self._drive.ahead)
        if (last.phase, last.progress) == (truth.phase, truth.progress):
            return last
        return replace(last, phase=truth.phase, progress=truth.progress)

    @property
    def touch(self) -> TouchSense | None:
        """The sense of touch; None before the trial has its scene."""
        return self._touch

    def drive(self, time: float, commands: FloatArray, q: FloatArray) -> FloatArray:
        """What the actuators do at a time (s) for commands (nu,), at true joints q (nq,)."""
        return self._drive.drive(time, commands, q)

    @property
    def numbers(self) -> dict[str, float]:
        """What was drawn as few numbers; see ``words.drawn_numbers``."""
        return drawn_numbers(self.drawn, self.task.hand)

    def to_dict(self) -> dict[str, Any]:
        """The reality's fields, what was drawn, and what taxels felt ("felt"), as plain data.

        "drawn_in_words" is a line for people, "" if nothing was drawn that lasts.
        """
        data = {
            **self.reality.to_dict(),
            "drawn": self.drawn.to_dict(),
            "drawn_in_words": draws_in_words([self.numbers]),
        }
        if isinstance(self._touch, TaxelSense):
            data["felt"] = self._touch.felt()
        return data
