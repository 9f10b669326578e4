"""``ManipulationSim``: a simulation with a driver, a moving base, samples and a push."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from planner.arrays import check_fields, finite_array
from planner.errors import TaskError
from planner.motion.manipulation import ManipulationPlan
from planner.spatial import SE3, FloatArray
from planner.task import GraspTask
from sim.contacts import hand_contacts
from sim.controllers import Observation
from sim.estimation import AnyEstimator
from sim.manipulation.driver import ManipulationDriver, mover_of
from sim.manipulation.in_hand import InHandController
from sim.manipulation.log import ManipulationRecorder
from sim.manipulation.reading import Reading
from sim.manipulation.timeline import (
    CONTROLLER_PHASE,
    IN_THE_AIR,
    ManipulationPhase,
    ManipulationTimeline,
)
from sim.physics import AnyPhysics
from sim.reality import AnyReality
from sim.simulation import Simulation
from sim.verdict import DropCriteria, lost

SAMPLE_EVERY = 0.02
"""Time between samples, s: that at which closure and forces are judged."""

DROPPED = DropCriteria(fewest=1)
"""In the air an object is dropped when no finger touches it, be it on the palm."""


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

    def __post_init__(self) -> None:
        """Check every number."""
        finite_array("the force of a push", self.force, (3,), error=TaskError)
        check_fields(self, ("after", "duration"), what="push: ", least=0.0, unit="s")


class ManipulationSim:
    """Runs phases of one manipulation and records them.

    Attributes:
        simulation: Scene, data and the loop.
        driver: Drives the fingers.
        mover: Moves the base, or the arm.
        recorder: Takes samples, of the truth.
        reading: What the robot knows of the object.
    """

    def __init__(
        self,
        plan: ManipulationPlan,
        *,
        controller: InHandController,
        timeline: ManipulationTimeline,
        true_task: GraspTask | None = None,
        physics: AnyPhysics | None = None,
        push: Push | None = None,
        reality: AnyReality | None = None,
        estimator: AnyEstimator | None = None,
    ) -> None:
        """Build the scene and put hand and object at their start; see ``manipulate``."""
        grasp = plan.grasp
        there = true_task or grasp.task
        there = replace(there, obstacles=(*there.obstacles, *plan.under_target))
        self.driver = ManipulationDriver(plan, controller, rate=timeline.turn_rate)
        self.simulation = Simulation(
            replace(grasp, task=there),
            physics=physics,
            controller=self.driver,
            reality=reality,
            estimator=estimator,
        )
        self.mover = mover_of(grasp, self.simulation.scene)
        self.simulation.carrier = self.mover
        axis = self.driver.reference.axis
        self.recorder = ManipulationRecorder(self.simulation, axis)
        self.reading = Reading(self.simulation, self.recorder, axis)
        self._push = push
        self._turn_began: float | None = None

    def run(
        self,
        phase: ManipulationPhase,
        duration: float,
        *,
        wait: float = 0.0,
        until: Callable[[Observation], bool] | None = None,
    ) -> str:
        """Run a phase for its duration, and longer where something is waited for.

        Args:
            phase: Which phase.
            duration: s.
            wait: Longest further time, s.
            until: Whether the phase may end after ``duration``, asked after every step with what
                the controller saw; at once if None.

        Returns:
            Why it ended early, "" if it did not: diverged, stopped, or the object fell.
        """
        simulation, recorder, driver = self.simulation, self.recorder, self.driver
        if self.mover.fault:
            return self.mover.fault
        if phase == "turn" and self._turn_began is None:
            self._turn_began = simulation.time
        pushed = self._push if phase in ("turn", "regrasp") else None
        before = None if pushed is None else lambda _: self._push_object(pushed)
        fault = ""
        for observation in simulation.run(
            CONTROLLER_PHASE[phase], duration, wait=wait, until=until, before=before
        ):
            recorder.note_forces(observation.normal_forces)
            due = simulation.due(SAMPLE_EVERY)
            fault = simulation.diverged or (self._dropped(phase) if due else "")
            if fault or due:
                recorder.record(
                    phase,
                    path_parameter=driver.reference.place,
                    wanted=driver.holding.T_palm_wanted,
                    away=driver.off,
                )
                self.reading.note()
            if fault:
                break
        simulation.data.xfrc_applied[simulation.scene.object_body] = 0.0
        self.mover.stay()
        return fault or (f"stopped: {simulation.stopped}" if simulation.stopped else "")

    @property
    def touched(self) -> bool:
        """Whether anything of the hand presses on the object."""
        return self.simulation.touching() > 0

    @property
    def touching_fingers(self) -> set[str]:
        """Names of the fingers that press on the object, the palm left out."""
        return set(hand_contacts(self.simulation.scene, self.simulation.data).fingers) - {""}

    @property
    def T_world_base(self) -> SE3:
        """Pose of the hand's base; on an arm of one that moves with the palm, see ``ArmMover``."""
        return self.mover.T_world_base(self.simulation)

    def base_for(self, T_world_object: SE3) -> SE3:
        """Where the base must be for the object, as it is read now, to be at a pose."""
        now = self.reading.T_world_object()
        return T_world_object * now.inverse() * self.T_world_base

    def _push_object(self, push: Push) -> None:
        """Push while it is time to."""
        since = self.simulation.time - (self._turn_began or 0.0)
        force = push.force if 0.0 <= since - push.after < push.duration else np.zeros(3)
        self.simulation.data.xfrc_applied[self.simulation.scene.object_body, :3] = force

    def _dropped(self, phase: ManipulationPhase) -> str:
        """Why the object counts as dropped, "" if it does not."""
        if phase not in IN_THE_AIR or not lost(DROPPED, touching=len(self.touching_fingers)):
            return ""
        gave_up = self.driver.holding.gave_up
        return "the object was dropped" + (f": {gave_up}" if gave_up else "")
