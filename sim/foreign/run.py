"""``ForeignRun``: a plan executed in a foreign scene, by its owner's steps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from planner.contacts import ContactSet
from planner.errors import TaskError
from planner.plan import GraspPlan
from planner.spatial import SE3, FloatArray, minimum_jerk, pose_change
from sim.contacts import hand_contacts
from sim.controllers import AnyController, Observation, Phase
from sim.controllers.grasp import RECLOSING_TIME, closing_ended
from sim.foreign.scene import WEIGHT, ForeignScene
from sim.scene.carrier import Timeline
from sim.simulation import Simulation

ARRIVED_MM, ARRIVED_DEG = 3.0, 1.5
"""How near its wanted pose a base has arrived: within the pre-grasp's opening."""


class ForeignRun(Simulation):
    """A plan executed in a foreign scene, whose owner makes the steps.

    Attributes:
        wanted: Where the hand's base was asked to be in the last step; the next way begins there.
        held: Pose of the object in the palm when the grasp was made, from which slip counts.
    """

    def __init__(
        self,
        plan: GraspPlan,
        scene: ForeignScene,
        step: Callable[[SE3, FloatArray], object],
        *,
        period: float,
        controller: AnyController | None = None,
    ) -> None:
        """Begin where the scene is.

        Args:
            plan: A plan for ``scene.task()``.
            scene: The scene.
            step: Makes one step of the scene: takes where the hand's base is wanted, and the
                commands (nu,) of the hand's actuators in the order of ``hand.actuation.names``.
            period: Time (s) that one of these steps takes.
            controller: What drives the hand; as ``Simulation``.
        """
        super().__init__(
            _bearing(plan),
            scene=scene.for_task(plan.task, period),
            controller=controller,
            carrier=_Nothing(),
        )
        self._make_step, self._foreign = step, scene
        self.wanted = self._from = self._to = scene.T_world_base
        self.held = self.T_palm_object

    def step(self, phase: Phase, share: float) -> Observation:
        """Have one step made; see ``Simulation.step``.

        Raises:
            TaskError: The first one took another time than ``period``.
        """
        observation = self.observe(phase, share)
        self._told = observation
        self._ctrl = self._commands(observation)
        s = float(minimum_jerk(np.asarray(share)))
        turn = SE3.Interpolate(_turn(self._from), _turn(self._to), s).rotation
        place = (1.0 - s) * self._from.translation + s * self._to.translation
        self.wanted = SE3(turn, place)
        before = float(self.data.time)
        self._make_step(self.wanted, self._ctrl)
        took = float(self.data.time) - before
        if self.steps == 0 and abs(took - self.timestep) > 0.5 * self.scene.model.opt.timestep:
            raise TaskError(
                f"period is {self.timestep:g} s, and the scene's step took {took:g} s; give that"
            )
        self.steps += 1
        return observation

    def move(
        self,
        T_world_base: SE3,
        duration: float,
        *,
        wait: float = 0.0,
        phase: Phase = "hold",
        until: Callable[[Observation], bool] | None = None,
    ) -> bool:
        """Bring the hand's base to a pose, straight.

        Args:
            T_world_base: The pose.
            duration: Of the way, s.
            wait: Longest further time (s) until it has arrived.
            phase: What the controller is told: "approach" before the grasp.
            until: When it may end once the way is over, instead of by arriving.

        Returns:
            Whether it came near the pose.
        """
        self._from, self._to = self.wanted, T_world_base
        for _ in self.run(phase, duration, wait=wait, until=until or self._arrived):
            pass
        return self._arrived()

    def grasp(self, timeline: Timeline | None = None, *, wait: float = 1.0) -> bool:
        """Approach, close and squeeze as the plan does, from where its approach begins.

        Args:
            timeline: Durations; defaults if None.
            wait: Longest further time (s) until the base has arrived.

        Returns:
            Whether as many fingers as the task needs feel the object.
        """
        timeline, plan = timeline or Timeline(), self.plan
        self.move(plan.T_world_base, timeline.approach, wait=wait, phase="approach")
        over = closing_ended(self.controller, timeline.close_wait, self.timestep)
        wait = timeline.close_wait + RECLOSING_TIME
        self.move(plan.T_world_base, timeline.close, wait=wait, phase="close", until=over)
        self.move(plan.T_world_base, timeline.squeeze, phase="squeeze")
        self.held = self.T_palm_object
        self.move(plan.T_world_base, timeline.settle, phase="settle")
        return self.touching() >= plan.task.fingers_needed

    @property
    def slip(self) -> tuple[float, float]:
        """How far the object has moved in the palm since it was grasped, mm and degrees."""
        return pose_change(self.held, self.T_palm_object)

    @property
    def contacts(self) -> ContactSet:
        """Measured contacts of hand and object, merged per finger, world: as those of a plan."""
        return hand_contacts(self.scene, self.data)

    @property
    def T_world_base(self) -> SE3:
        """Pose of the hand's base; see ``ForeignScene.T_world_base``."""
        return self._foreign.T_world_base

    def _arrived(self, observation: Observation | None = None) -> bool:
        far, turned = pose_change(self._to, self.T_world_base)
        return far <= ARRIVED_MM and turned <= ARRIVED_DEG


def _bearing(plan: GraspPlan) -> GraspPlan:
    """The plan with the forces that bear the weight at the model's own centre of mass.

    Those with and those without the margin times the weight's moment are proven; what is between
    them lies in the same friction cones and limits.
    """
    for one, found in zip(plan.task.needed, plan.needed, strict=True):
        if one.name == WEIGHT:
            more = found.contacts.forces - plan.contacts.forces
            forces = plan.contacts.forces + more / plan.task.needed_margin
            return replace(plan, contacts=plan.contacts.with_forces(forces))
    return plan


class _Nothing:
    """A carrier that moves nothing: the scene's owner carries the hand."""

    def drive(self, data: Any, phase: Phase, share: float) -> None:
        """Nothing."""


def _turn(pose: SE3) -> SE3:
    return SE3(pose.rotation, np.zeros(3))
